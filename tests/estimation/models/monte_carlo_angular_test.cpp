// The angular model against light from single directions into single directions, walked by other
// code, and against what design/estimation.md and science.md publish.
#include "estimation/models/monte_carlo_angular.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "estimation/models/monte_carlo/single_scattering.h"
#include "estimation/models/monte_carlo_angular/angular_score.h"
#include "estimation/models/monte_carlo_angular/shipped_angular_tables.h"
#include "tests/estimation/truth/directional_monte_carlo.h"

namespace estimation {
namespace {

using std::numbers::pi;
using testing::DirectionalRun;
using testing::run_directional;

constexpr double kDegree = pi / 180;
constexpr Coefficients kCheekRed{0.0525, 1.2814}, kStubbleRed{0.4056, 0.9237};

std::unique_ptr<MonteCarloAngular> model_of(const ShippedTable& shipped) {
  const AngularTable angular = *angular_table_from_text(shipped.text, "shipped");
  for (const ShippedTable& hemispherical : shipped_tables()) {
    const ScatteringTable table = *scattering_table_from_text(hemispherical.text, "shipped");
    if (table.eta == angular.eta && table.anisotropy == angular.anisotropy)
      return std::make_unique<MonteCarloAngular>(table, angular);
  }
  return nullptr;
}

const MonteCarloAngular& model() {
  static const std::unique_ptr<MonteCarloAngular> kModel =
      model_of(shipped_angular_tables().front());
  return *kModel;
}

double s_of(double absorption) { return std::sqrt(3 * absorption * (1 + absorption)); }

std::complex<double> factor(double absorption, double k_tmfp, const Directions& directions) {
  const double s = s_of(absorption), k_times_l_d = k_tmfp / s;
  std::complex<double> out;
  model().direction_factors(model().reflectance_at(s), {&k_times_l_d, 1}, directions, {&out, 1});
  return out;
}

// The mean over all exits of a hemisphere, weighted as flux.
std::complex<double> all_exits(double absorption, double k_tmfp, double incidence_rad,
                               double azimuth_rad) {
  const Quadrature radii = gauss_legendre(12);
  constexpr int kAzimuths = 16;
  std::complex<double> sum = 0;
  for (std::size_t i = 0; i < radii.node.size(); ++i)
    for (int j = 0; j < kAzimuths; ++j)
      sum += radii.weight[i] / kAzimuths *
             factor(absorption, k_tmfp,
                    {.cos_incidence = std::cos(incidence_rad),
                     .cos_exit = std::sqrt(1 - radii.node[i]),
                     .incidence_azimuth_rad = azimuth_rad,
                     .exit_azimuth_rad = 2 * pi * j / kAzimuths});
  return sum;
}

struct Case {
  double absorption, incidence_deg, incidence_azimuth_deg, exit_deg, exit_azimuth_deg;
};

TEST(MonteCarloAngular, AgreesWithDirectWalksBetweenItsNodes) {
  const Case cases[] = {{0.041, 0, 0, 14, 0},    {0.041, 45, 90, 20, 0}, {0.041, 60, 180, 31, 180},
                        {0.0123, 50, 0, 35, 0},  {0.1, 30, 135, 50, 10}, {0.439, 45, 30, 25, 200},
                        {0.439, 60, 0, 60, 180}, {0.439, 60, 0, 45, 0},  {1.5, 40, 60, 30, 180},
                        {0.2, 14, 270, 37, 330}};
  double worst = 0;
  std::uint64_t seed = 100;
  for (const Case& c : cases) {
    DirectionalRun run;
    run.absorption = c.absorption;
    run.directions = {std::cos(c.incidence_deg * kDegree), std::cos(c.exit_deg * kDegree),
                      c.incidence_azimuth_deg * kDegree, c.exit_azimuth_deg * kDegree};
    run.k_tmfp = 0.37;
    run.photon_count = 100000;
    run.seed = ++seed;
    const auto truth = run_directional(run);
    for (int n = 0; n <= run.harmonic_count; ++n) {
      const auto i = static_cast<std::size_t>(n);
      const double k_tmfp = n * run.k_tmfp;
      const double transform = model().transform_at(s_of(c.absorption), k_tmfp);
      const std::complex<double> found = factor(c.absorption, k_tmfp, run.directions);
      const std::complex<double> difference = found - truth.value[i] / transform;
      const double table_se =
          model().factor_standard_error(s_of(c.absorption), k_tmfp, run.directions);
      // Real and imaginary part together: 4.5 standard errors are passed once in 2e4, and 0.7% are
      // left to the form of the table.
      const double allowed =
          4.5 * std::hypot(truth.se[i] / transform, table_se) + 0.007 * std::abs(found);
      worst = std::max(worst, std::abs(difference) / allowed);
      EXPECT_LT(std::abs(difference), allowed)
          << "x " << c.absorption << " k " << k_tmfp << " incidence " << c.incidence_deg << ", "
          << c.incidence_azimuth_deg << " exit " << c.exit_deg << ", " << c.exit_azimuth_deg
          << ": found " << found << " direct " << truth.value[i] / transform << " +- "
          << truth.se[i] / transform;
    }
  }
  std::printf("worst difference from direct walks: %.2f of what is allowed\n", worst);
}

TEST(MonteCarloAngular, EveryShippedTableAgreesWithADirectWalk) {
  for (const ShippedTable& shipped : shipped_angular_tables()) {
    SCOPED_TRACE(shipped.file_name);
    const AngularTable angular = *angular_table_from_text(shipped.text, "shipped");
    const std::unique_ptr<MonteCarloAngular> other = model_of(shipped);
    ASSERT_TRUE(other);
    const double absorption = 0.15, s = s_of(absorption);
    DirectionalRun run;
    run.eta = angular.eta;
    run.anisotropy = angular.anisotropy;
    run.absorption = absorption;
    run.directions = {std::cos(45 * kDegree), std::cos(20 * kDegree), 1.0, 3.5};
    run.k_tmfp = 0.6;
    run.harmonic_count = 4;
    run.photon_count = 60000;
    const auto truth = run_directional(run);
    const double reflectance = other->reflectance_at(s);
    for (int n = 0; n <= run.harmonic_count; ++n) {
      const auto i = static_cast<std::size_t>(n);
      const double k_times_l_d = n * run.k_tmfp / s;
      double transform;
      std::complex<double> found;
      other->transform(reflectance, {&k_times_l_d, 1}, {&transform, 1});
      other->direction_factors(reflectance, {&k_times_l_d, 1}, run.directions, {&found, 1});
      EXPECT_LT(std::abs(found * transform - truth.value[i]),
                4.5 * truth.se[i] + 0.015 * std::abs(truth.value[i]));
    }
  }
}

// design/estimation.md, section 1: 0.12 mm at 14 degrees, 0.25 at 30, 0.35 at 45, 0.43 at 60 for
// the first harmonic of 40 px of 0.3 mm, two thirds of that at f = 0.5/mm; towards where light
// goes.
TEST(MonteCarloAngular, ShiftsObliqueLightAsPublished) {
  const double absorption = kCheekRed.sigma_a_per_mm / kCheekRed.sigma_s_prime_per_mm;
  const auto shift_mm = [&](double f_per_mm, double incidence_deg, double azimuth_rad) {
    const double k_per_mm = 2 * pi * f_per_mm;
    return std::arg(all_exits(absorption, k_per_mm / kCheekRed.sigma_s_prime_per_mm,
                              incidence_deg * kDegree, azimuth_rad)) /
           k_per_mm;
  };
  const struct {
    double incidence_deg, shift_mm;
  } published[] = {{14, 0.12}, {30, 0.25}, {45, 0.35}, {60, 0.43}};
  for (const auto& row : published) {
    const double found = shift_mm(1.0 / 12, row.incidence_deg, 0);
    const double at_half = shift_mm(0.5, row.incidence_deg, 0);
    std::printf("shift at %.0f degrees: %.3f mm, at f 0.5/mm %.2f of it\n", row.incidence_deg,
                found, at_half / found);
    EXPECT_NEAR(found, row.shift_mm, 0.012);
    EXPECT_NEAR(at_half / found, 0.63, 0.07);
    // From the other side, and from the side.
    EXPECT_NEAR(shift_mm(1.0 / 12, row.incidence_deg, pi), -found, 0.003);
    EXPECT_NEAR(shift_mm(1.0 / 12, row.incidence_deg, pi / 2), 0, 0.003);
  }
}

// |R~(0)| per transmitted flux at 45 degrees: +4% (cheek red) to +11% (stubble red).
TEST(MonteCarloAngular, ObliqueLightComesOutStrongerAsPublished) {
  for (const auto& [medium, published] :
       {std::pair(kCheekRed, 1.04), std::pair(kStubbleRed, 1.11)}) {
    const double absorption = medium.sigma_a_per_mm / medium.sigma_s_prime_per_mm;
    const double found =
        std::abs(all_exits(absorption, 0, pi / 4, 0)) / transmitted_frac(1.4, std::cos(pi / 4));
    std::printf("|R~(0)| at 45 degrees: %.3f\n", found);
    EXPECT_NEAR(found, published, 0.011);
  }
}

// design/science.md: h 1.04 to 1.05 at 45 degrees for any albedo, 1.00 at 70 at the lowest.
// Elsewhere h is monte_carlo's, fitted to other photons.
TEST(MonteCarloAngular, ExitRadianceIsAsPublished) {
  for (const Coefficients& medium : {kCheekRed, kStubbleRed, Coefficients{0.013, 1.09}}) {
    const double absorption = medium.sigma_a_per_mm / medium.sigma_s_prime_per_mm;
    for (const double exit_deg : {0.0, 45.0, 70.0}) {
      const double cos_exit = std::cos(exit_deg * kDegree);
      const double h = factor(absorption, 0, {.cos_incidence = 1, .cos_exit = cos_exit}).real() /
                       transmitted_frac(1.4, 1);
      std::printf("h %.3f at %.0f degrees\n", h, exit_deg);
      EXPECT_NEAR(h, model().MonteCarlo::exit_radiance(s_of(absorption), cos_exit), 0.012);
      if (exit_deg == 45) {
        EXPECT_NEAR(h, 1.045, 0.012);
      }
    }
  }
}

// The mean over exits at normal incidence is R~ times T, by both tables' photons.
TEST(MonteCarloAngular, AllExitsTogetherAreTheHemisphericalModel) {
  for (const double absorption : {0.003, 0.041, 0.439, 2.0})
    for (const double k_tmfp : {0.0, 0.3, 1.0, 2.5}) {
      SCOPED_TRACE(::testing::Message() << "x " << absorption << " k " << k_tmfp);
      const std::complex<double> mean = all_exits(absorption, k_tmfp, 0, 0);
      EXPECT_NEAR(mean.real() / transmitted_frac(1.4, 1), 1, 0.01);
      EXPECT_NEAR(mean.imag(), 0, 1e-4);
    }
}

// The direct walk knows nothing of reciprocity, so it is a test of the walk.
TEST(DirectionalMonteCarlo, IsReciprocal) {
  DirectionalRun run;
  run.absorption = 0.25;
  run.directions = {std::cos(50 * kDegree), std::cos(10 * kDegree), 0.7, 2.9};
  run.photon_count = 60000;
  const auto there = run_directional(run);
  run.directions = {run.directions.cos_exit, run.directions.cos_incidence,
                    run.directions.exit_azimuth_rad, run.directions.incidence_azimuth_rad};
  run.seed = 2;
  const auto back = run_directional(run);
  for (std::size_t n = 0; n < there.value.size(); ++n)
    EXPECT_LT(std::abs(there.value[n] - std::conj(back.value[n])),
              4.5 * std::hypot(there.se[n], back.se[n]))
        << n;
}

TEST(MonteCarloAngular, KeepsReciprocityAndMirrors) {
  std::mt19937_64 random(8);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (int draw = 0; draw < 200; ++draw) {
    const Directions there{0.3 + 0.7 * uniform(), 0.3 + 0.7 * uniform(), 7 * uniform(),
                           7 * uniform()};
    const Directions back{there.cos_exit, there.cos_incidence, there.exit_azimuth_rad,
                          there.incidence_azimuth_rad};
    const Directions mirrored{there.cos_incidence, there.cos_exit, -there.incidence_azimuth_rad,
                              -there.exit_azimuth_rad};
    const double absorption = 2 * uniform(), k_tmfp = 4 * uniform();
    const std::complex<double> found = factor(absorption, k_tmfp, there);
    EXPECT_LT(std::abs(found - std::conj(factor(absorption, k_tmfp, back))), 1e-5);
    EXPECT_LT(std::abs(found - factor(absorption, k_tmfp, mirrored)), 1e-5);
  }
}

TEST(MonteCarloAngular, IsFiniteAndContinuousEverywhere) {
  std::mt19937_64 random(9);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (int draw = 0; draw < 2000; ++draw) {
    const double logit = 40 * uniform() - 20;
    const double reflectance = 1 / (1 + std::exp(-logit));
    const Directions directions{uniform(), uniform(), 7 * uniform(), 7 * uniform()};
    const double x = std::pow(10.0, 8 * uniform() - 4);
    const double k_times_l_d[] = {0, x, x * (1 + 1e-6)};
    std::complex<double> out[3];
    model().direction_factors(reflectance, k_times_l_d, directions, out);
    for (const auto& value : out) {
      EXPECT_TRUE(std::isfinite(value.real()) && std::isfinite(value.imag()));
      EXPECT_LT(std::abs(value), 20);
    }
    EXPECT_NEAR(out[0].imag(), 0, 1e-5);
    EXPECT_LT(std::abs(out[1] - out[2]), 1e-4);
  }
}

TEST(MonteCarloAngular, NothingComesFromOrGoesBelow) {
  for (const Directions& below : {Directions{.cos_incidence = 0}, Directions{.cos_exit = -0.1}})
    EXPECT_EQ(factor(0.1, 0.5, below), 0.0);
  const double k_times_l_d = 1;
  std::complex<double> out;
  model().direction_factors(1.1, {&k_times_l_d, 1}, {}, {&out, 1});
  EXPECT_TRUE(std::isnan(out.real()));
}

// The closed form per pair of directions, summed over exits, is the one per hemisphere.
TEST(AngularScore, SingleScatteringSumsToTheHemispheres) {
  const WalkMedium medium;
  const Quadrature radii = gauss_legendre(24);
  constexpr int kAzimuths = 32;
  for (const double absorption : {0.0, 0.4, 3.0})
    for (const double k_tmfp : {0.0, 1.0, 6.0}) {
      std::complex<double> sum = 0;
      for (std::size_t i = 0; i < radii.node.size(); ++i)
        for (int j = 0; j < kAzimuths; ++j) {
          const double r = std::sqrt(radii.node[i]), azimuth_rad = 2 * pi * j / kAzimuths;
          sum += radii.weight[i] / kAzimuths * transmitted_frac(medium.eta, std::sqrt(1 - r * r)) *
                 single_scattering(medium, absorption, k_tmfp, {},
                                   {r * std::cos(azimuth_rad), r * std::sin(azimuth_rad)});
        }
      const double expected = SingleScattering(medium).transform(absorption, k_tmfp);
      EXPECT_NEAR(sum.real(), expected, 2e-3 * expected);
      EXPECT_NEAR(sum.imag(), 0, 1e-12);
    }
}

TEST(DirectionPairs, AreOrthonormalOverBothDiscs) {
  const Quadrature radii = gauss_legendre(6);
  constexpr int kAzimuths = 12;
  std::vector<DiscPoint> points;
  std::vector<double> weights;
  for (std::size_t i = 0; i < radii.node.size(); ++i)
    for (int j = 0; j < kAzimuths; ++j) {
      const double r = std::sqrt(radii.node[i]), azimuth_rad = 2 * pi * (j + 0.3) / kAzimuths;
      points.push_back({r * std::cos(azimuth_rad), r * std::sin(azimuth_rad)});
      weights.push_back(radii.weight[i] / kAzimuths);
    }
  std::vector<double> products(DirectionPairs::kPairs * DirectionPairs::kPairs);
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t o = 0; o < points.size(); ++o) {
      const auto basis = DirectionPairs::basis(DirectionPairs::polynomials(points[i]),
                                               DirectionPairs::polynomials(points[o]));
      for (std::size_t p = 0; p < basis.size(); ++p)
        for (std::size_t q = 0; q < basis.size(); ++q)
          products[p * basis.size() + q] += weights[i] * weights[o] * basis[p] * basis[q];
    }
  for (std::size_t p = 0; p < DirectionPairs::kPairs; ++p)
    for (std::size_t q = 0; q < DirectionPairs::kPairs; ++q)
      EXPECT_NEAR(products[p * DirectionPairs::kPairs + q], p == q ? 1 : 0, 1e-12);
}

TEST(AngularTable, TextIsReadBackAsItWasWritten) {
  for (const ShippedTable& shipped : shipped_angular_tables()) {
    SCOPED_TRACE(shipped.file_name);
    const auto table = angular_table_from_text(shipped.text, "shipped");
    ASSERT_TRUE(table) << table.error().text();
    EXPECT_EQ(to_text(*table), shipped.text);
    EXPECT_LT(shipped.text.size(), 200000U);
  }
}

TEST(AngularTable, BrokenTextIsRefusedWithItsLine) {
  const std::string text(shipped_angular_tables().front().text);
  const auto error_of = [](const std::string& broken) {
    const auto table = angular_table_from_text(broken, "broken.txt");
    return table ? std::string("accepted") : table.error().text();
  };
  EXPECT_NE(error_of("").find("line 1"), std::string::npos);
  EXPECT_NE(error_of(text.substr(0, text.size() / 2)).find("broken.txt"), std::string::npos);
  EXPECT_NE(error_of(text + "1").find("the end"), std::string::npos);
  std::string nan = text;
  nan.replace(text.rfind(' '), 2, " nan");
  EXPECT_NE(error_of(nan).find("a number"), std::string::npos);
}

TEST(MonteCarloAngular, IsFoundByNameForTheMediaOfItsTables) {
  const auto found = make_scattering_model("monte_carlo_angular", {});
  ASSERT_TRUE(found) << found.error().text();
  EXPECT_EQ((*found)->name(), "monte_carlo_angular");
  const auto missing = make_scattering_model("monte_carlo_angular", {.anisotropy = 0.77});
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().text().find("g 0.8"), std::string::npos);
}

}  // namespace
}  // namespace estimation
