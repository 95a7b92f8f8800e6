// The paper's table against its eq. 3, integrated in space over the stripes.
#include "estimation/profile/profile_table.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>
#include <vector>

#include "tests/estimation/models/spatial_dipole.h"

namespace estimation {
namespace {

using std::numbers::pi;
using testing::integrate;
using testing::SpatialDipole;

constexpr double kEta = 1.4;
constexpr std::array kRows = {0, 3, 20, 60, 100, 140, 175, 193, 199};

const ProfileTable& wide_table() {
  static const ProfileTable table(Dipole(kEta), StripeShape{}, TableRange{});
  return table;
}

// With l_d = 1; every other l_d is a change of unit.
SpatialDipole spatial_dipole(double reflectance) {
  return {Dipole(kEta).coefficients(reflectance, 1), kEta};
}

// Line responses at the nodes of a quadrature over x >= 0, in units of l_d: panels that grow from
// the source's depth, none longer than `longest`.
struct LineNodes {
  std::vector<double> x, weighted;

  LineNodes(const SpatialDipole& dipole, double longest) {
    for (double low = 0, high = 0; low < 36; low = high) {
      high = low + std::min(0.25 * std::hypot(low, dipole.z_real), longest);
      integrate(
          [&](double node) {
            x.push_back(node);
            return 0.0;
          },
          low, high, 1);
      // The weights of a panel are those of integrating its nodes' own unit functions.
      for (std::size_t i = 0; i < 5; ++i) {
        std::size_t at = 0;
        weighted.push_back(2 *
                           integrate([&](double) { return at++ == i ? 1.0 : 0.0; }, low, high, 1));
      }
    }
    tbb::parallel_for(std::size_t{0}, x.size(),
                      [&](std::size_t i) { weighted[i] *= dipole.line_response(x[i]); });
  }
  double transform(double k) const {
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i) sum += weighted[i] * std::cos(k * x[i]);
    return sum;
  }
};

double stripe_harmonic(StripeShape shape, std::size_t n) {
  const double x = pi * static_cast<double>(n) * shape.width_px / shape.period_px;
  return std::sin(x) / x;
}

// Every harmonic of the whole range of R_d and l_d; the ones that the table leaves out count as
// zero as long as the table has room for more.
TEST(ProfileTable, HarmonicsEqualSpatialQuadratureOfEquation3) {
  const ProfileTable& table = wide_table();
  const StripeShape shape = table.shape();
  double worst = 0;
  for (const int row : kRows) {
    const double reflectance = table.reflectance_at(row);
    const SpatialDipole dipole = spatial_dipole(reflectance);
    for (const int col : {0, 30, 75, 110, 140, 170, 199}) {
      const double l_d_px = table.translucency_px_at(col);
      const auto all = table.all_harmonics(row, col);
      const double base = 2 * pi / shape.period_px * l_d_px;
      const std::size_t last = std::min<std::size_t>(
          all.size() + 10, static_cast<std::size_t>(table.greatest_harmonic_count()));
      const LineNodes nodes(dipole, std::min(0.5, 1.0 / (base * static_cast<double>(last))));
      const double total = nodes.transform(0);
      EXPECT_NEAR(total, reflectance, 1e-11);
      for (std::size_t n = 1; n <= last; n += 1 + n / 4) {
        const double expected =
            stripe_harmonic(shape, n) * nodes.transform(base * static_cast<double>(n)) / total;
        const double found = n <= all.size() ? all[n - 1] : 0;
        worst = std::max(worst, std::abs(found - expected));
        EXPECT_NEAR(found, expected, 1e-10)
            << "R_d " << reflectance << " l_d " << l_d_px << " px, harmonic " << n;
      }
    }
  }
  std::printf("harmonics against quadrature of eq. 3: within %.1e\n", worst);
}

// The share of the profile within [0, x] of its centre line, x in l_d.
double edge_response(const SpatialDipole& dipole, double x) {
  const double t = std::asinh(x / dipole.z_real);
  return integrate(
      [&](double u) {
        return dipole.line_response(dipole.z_real * std::sinh(u)) * dipole.z_real * std::cosh(u);
      },
      0, t, std::max(1, static_cast<int>(std::ceil(4 * t))));
}

// r of a pixel at distance x_px from the centre of a stripe, all stripes summed, its mean 1.
double profile_by_quadrature(const SpatialDipole& dipole, StripeShape shape, double l_d_px,
                             double x_px, double reflectance) {
  double sum = 0;
  const double reach_px = 36 * l_d_px + shape.period_px;
  const int periods = static_cast<int>(std::ceil(reach_px / shape.period_px));
  for (int m = -periods; m <= periods; ++m) {
    const double centre_px = x_px + m * shape.period_px;
    const auto edge = [&](double edge_px) {
      const double x = std::min(std::abs(edge_px) / l_d_px, 36.0);
      return std::copysign(edge_response(dipole, x), edge_px);
    };
    sum += edge(centre_px + 0.5 * shape.width_px) - edge(centre_px - 0.5 * shape.width_px);
  }
  return sum * shape.period_px / shape.width_px / reflectance;
}

double profile_by_table(const ProfileTable& table, int row, int col, double x_px) {
  double sum = 1, n = 1;
  for (const double harmonic : table.all_harmonics(row, col))
    sum += 2 * harmonic * std::cos(2 * pi * n++ * x_px / table.shape().period_px);
  return sum;
}

// Where the table has room for all harmonics of a material (R_d 0.5: l_d above 7 px; 0.3: 3.6 px),
// its profile is eq. 3 to 1e-10 at any position; elsewhere the sharpest part of the edges is cut
// off.
TEST(ProfileTable, ProfilesEqualSpatialQuadratureOfEquation3) {
  const ProfileTable& table = wide_table();
  const StripeShape shape = table.shape();
  const auto limit = static_cast<std::size_t>(table.greatest_harmonic_count());
  double worst = 0;
  int complete_count = 0;
  for (int row = 0; row < ProfileTable::kRows; ++row)
    for (int col = 0; col < ProfileTable::kCols; ++col)
      complete_count += table.all_harmonics(row, col).size() < limit ? 1 : 0;
  for (const int row : kRows) {
    const double reflectance = table.reflectance_at(row);
    const SpatialDipole dipole = spatial_dipole(reflectance);
    for (int col = 0; col < ProfileTable::kCols; col += 17) {
      if (table.all_harmonics(row, col).size() >= limit) continue;
      for (const double x_px : {0.0, 2.7, 4.0, 11.3, 20.0}) {
        const double expected =
            profile_by_quadrature(dipole, shape, table.translucency_px_at(col), x_px, reflectance);
        const double found = profile_by_table(table, row, col, x_px);
        worst = std::max(worst, std::abs(found - expected));
        EXPECT_NEAR(found, expected, 1e-10) << "R_d " << reflectance << " l_d "
                                            << table.translucency_px_at(col) << " px at " << x_px;
      }
    }
  }
  EXPECT_GT(complete_count, 12000);
  std::printf("profiles against quadrature of eq. 3: within %.1e (%d of 40000 entries complete)\n",
              worst, complete_count);
}

TEST(ProfileTable, VisibleHarmonicsAreTheFirstOfAll) {
  const ProfileTable& table = wide_table();
  for (const int row : kRows)
    for (int col = 0; col < ProfileTable::kCols; col += 11) {
      const auto visible = table.harmonics(row, col), all = table.all_harmonics(row, col);
      ASSERT_LE(visible.size(), all.size());
      EXPECT_EQ(visible.data(), all.data());
      for (std::size_t n = visible.size(); n < all.size(); ++n) EXPECT_LT(std::abs(all[n]), 3e-5);
      if (visible.size() > 1) {
        EXPECT_GE(std::abs(visible.back()), 3e-5);
      }
      const auto alone = profile_harmonics(Dipole(kEta), table.shape(), table.reflectance_at(row),
                                           table.translucency_px_at(col));
      ASSERT_EQ(alone.size(), visible.size());
      for (std::size_t n = 0; n < alone.size(); ++n)
        EXPECT_NEAR(static_cast<double>(alone[n]), visible[n], 1e-7);
    }
}

TEST(ProfileTable, HasTheSameBitsForAnyNumberOfThreads) {
  const oneapi::tbb::global_control one_thread(oneapi::tbb::global_control::max_allowed_parallelism,
                                               1);
  const ProfileTable alone(Dipole(kEta), StripeShape{}, TableRange{});
  const ProfileTable& table = wide_table();
  for (int row = 0; row < ProfileTable::kRows; ++row)
    for (int col = 0; col < ProfileTable::kCols; ++col)
      ASSERT_TRUE(std::ranges::equal(alone.all_harmonics(row, col), table.all_harmonics(row, col)));
}

}  // namespace
}  // namespace estimation
