// The dipole in closed form against the paper's own equations, integrated in space.
#include "estimation/models/dipole.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "tests/estimation/models/spatial_dipole.h"

namespace estimation {
namespace {

double transform_at(const Dipole& dipole, double reflectance, double k_times_l_d) {
  double value = 0;
  dipole.transform(reflectance, std::span(&k_times_l_d, 1), std::span(&value, 1));
  return value;
}

using testing::integrate;
using testing::SpatialDipole;

TEST(Dipole, TransformEqualsSpatialQuadratureOfEquation3) {
  const Coefficients cheek_red{0.0525, 1.2814}, stubble_blue{0.6707, 0.6648};
  for (const Coefficients& medium : {cheek_red, stubble_blue}) {
    const SpatialDipole spatial(medium, 1.4);
    const Dipole dipole(1.4);
    const double reflectance = dipole_reflectance(medium, 1.4);
    const double l_d_mm = diffuse_mean_free_path_mm(medium);
    for (const double k_per_mm : {0.0, 0.1, 0.5236, 2.0}) {
      SCOPED_TRACE(::testing::Message()
                   << "sigma_a " << medium.sigma_a_per_mm << " k " << k_per_mm);
      const double spatial_value =
          2 * integrate([&](double x) { return spatial.line_response(x) * std::cos(k_per_mm * x); },
                        0, 40 * l_d_mm, 1200);
      EXPECT_NEAR(transform_at(dipole, reflectance, k_per_mm * l_d_mm), spatial_value, 1e-10);
    }
  }
}

// Between no light at all and none absorbed the depth of the sources spans nine decades of l_d:
// panels in u, x = depth sinh(u).
TEST(Dipole, TransformEqualsSpatialQuadratureAtBothEndsOfReflectance) {
  const Dipole dipole(1.4);
  for (const double reflectance : {1e-6, 1e-4, 0.01, 0.5, 0.99, 1 - 1e-4, 1 - 1e-6, 1 - 1e-9}) {
    const SpatialDipole spatial(dipole.coefficients(reflectance, 1), 1.4);
    for (const double k_times_l_d : {0.0, 0.1, 1.0, 10.0, 100.0}) {
      SCOPED_TRACE(::testing::Message() << "R_d " << reflectance << " k l_d " << k_times_l_d);
      const auto integrand = [&](double x) {
        return spatial.line_response(x) * std::cos(k_times_l_d * x);
      };
      // Panels that grow with the distance, then even ones where the cosine turns.
      const double grown = std::min(10 / (k_times_l_d + 0.25), 40.0);
      const double near = integrate(
          [&](double u) {
            return integrand(spatial.z_real * std::sinh(u)) * spatial.z_real * std::cosh(u);
          },
          0, std::asinh(grown / spatial.z_real), 400);
      const double far = integrate(integrand, grown, 40, static_cast<int>(40 * (k_times_l_d + 5)));
      EXPECT_NEAR(transform_at(dipole, reflectance, k_times_l_d), 2 * (near + far),
                  1e-10 * std::max(reflectance, 1e-3));
    }
  }
}

TEST(Dipole, InversionIsExactAtBothEndsAndBetween) {
  const Dipole dipole(1.4);
  EXPECT_EQ(dipole.s_at(1.0), 0.0);
  EXPECT_EQ(dipole.s_at(0.0), std::sqrt(3.0));
  EXPECT_TRUE(std::isnan(dipole.s_at(1.0000001)));
  EXPECT_TRUE(std::isnan(dipole.s_at(-1e-9)));
  EXPECT_TRUE(std::isnan(dipole.s_at(std::nan(""))));
  std::mt19937_64 random(1);
  for (int draw = 0; draw < 2000; ++draw) {
    const double exponent = -9.0 * static_cast<double>(random() >> 11) * 0x1p-53;
    const double s = std::sqrt(3.0) * std::pow(10.0, exponent);
    SCOPED_TRACE(s);
    // One rounding of R_d next to 1 is 1.1e-16; R_d falls about four times as fast as s rises.
    EXPECT_NEAR(dipole.s_at(dipole.reflectance_at(s)), s, 1e-13 * s + 2e-16);
  }
}

TEST(Dipole, CoefficientsAreInvertedFromReflectanceAndTranslucency) {
  std::mt19937_64 random(2);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (int draw = 0; draw < 2000; ++draw) {
    const double eta = 1.0 + 0.6 * uniform();
    const Coefficients truth{std::pow(10.0, -4 + 5 * uniform()),
                             std::pow(10.0, -1 + 2 * uniform())};
    SCOPED_TRACE(::testing::Message() << truth.sigma_a_per_mm << " " << truth.sigma_s_prime_per_mm);
    const Coefficients found =
        Dipole(eta).coefficients(dipole_reflectance(truth, eta), diffuse_mean_free_path_mm(truth));
    EXPECT_NEAR(found.sigma_a_per_mm / truth.sigma_a_per_mm, 1, 1e-9);
    EXPECT_NEAR(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm, 1, 1e-9);
  }
}

TEST(Dipole, TransformAtZeroIsTheReflectanceAndFallsWithFrequency) {
  const Dipole dipole(1.4);
  for (const double reflectance : {0.01, 0.3, 0.7, 0.999}) {
    SCOPED_TRACE(reflectance);
    EXPECT_NEAR(transform_at(dipole, reflectance, 0), reflectance, 1e-14);
    double previous = reflectance;
    for (double k_times_l_d = 0.5; k_times_l_d < 50; k_times_l_d *= 1.5) {
      const double value = transform_at(dipole, reflectance, k_times_l_d);
      EXPECT_LT(value, previous);
      EXPECT_GE(value, 0);
      previous = value;
    }
  }
}

// Jensen et al. (2001), skin1 and skin2 at eta 1.3: identical to Pixar's PxrSurface table
// (design/facts.md, section 5.2), which gives three decimals of R_d and two of l_d.
TEST(Dipole, PublishedSkinMatchesThePxrSurfaceTable) {
  struct Case {
    Coefficients medium;
    double reflectance, l_d_mm;
  };
  const Case cases[] = {{{0.032, 0.74}, 0.436, 3.67}, {{0.17, 0.88}, 0.227, 1.37},
                        {{0.48, 1.01}, 0.131, 0.68},  {{0.013, 1.09}, 0.623, 4.82},
                        {{0.070, 1.59}, 0.433, 1.69}, {{0.145, 1.79}, 0.343, 1.09}};
  for (const Case& skin : cases) {
    SCOPED_TRACE(skin.reflectance);
    EXPECT_NEAR(dipole_reflectance(skin.medium, 1.3), skin.reflectance, 0.0006);
    EXPECT_NEAR(diffuse_mean_free_path_mm(skin.medium), skin.l_d_mm, 0.006);
  }
}

// The translucency column of the paper's Table 2 is eq. 6 of its other columns for each measured
// area (its means are means of maps, so they are not).
TEST(Dipole, Table2TranslucencyIsEquation6) {
  std::ifstream table(SSRIG_TEST_DATA "/tariq2006_table2.csv");
  ASSERT_TRUE(table) << "tests/data/tariq2006_table2.csv";
  int row_count = 0;
  for (std::string line; std::getline(table, line);) {
    if (line.empty() || line[0] == '#' || line.starts_with("subject")) continue;
    SCOPED_TRACE(line);
    std::stringstream cells(line);
    std::string subject, area, cell;
    std::getline(cells, subject, ',');
    std::getline(cells, area, ',');
    std::vector<double> value;
    while (std::getline(cells, cell, ',')) value.push_back(std::stod(cell));
    ASSERT_EQ(value.size(), 9U);
    if (area == "mean" || area == "std") continue;
    for (std::size_t band = 0; band < 3; ++band)
      EXPECT_NEAR(diffuse_mean_free_path_mm({value[band], value[3 + band]}) / value[6 + band], 1,
                  2.5e-4);
    ++row_count;
  }
  EXPECT_EQ(row_count, 8);
}

TEST(ScatteringModel, UnknownNamesAndIndicesAreRefused) {
  EXPECT_TRUE(make_scattering_model("dipole", {}));
  const auto unknown = make_scattering_model("tripole", {});
  ASSERT_FALSE(unknown);
  EXPECT_NE(unknown.error().text().find("tripole"), std::string::npos);
  EXPECT_FALSE(make_scattering_model("dipole", {.eta = 0.9}));
  EXPECT_FALSE(make_scattering_model("dipole", {.eta = std::nan("")}));
}

}  // namespace
}  // namespace estimation
