// The profiles of renderers: their transforms against the published profiles, integrated in space.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "estimation/models/burley.h"
#include "estimation/models/gaussians.h"
#include "tests/estimation/models/spatial_dipole.h"

namespace estimation {
namespace {

using std::numbers::pi;
using testing::integrate;

double transform_at(const ScatteringModel& model, double reflectance, double k_times_l_d) {
  double value = 0;
  model.transform(reflectance, {&k_times_l_d, 1}, {&value, 1});
  return value;
}

// r R(r) as printed in Christensen and Burley (2015), l_d = 1.
double burley_profile_times_r(double albedo, double r) {
  const double s = 3.5 + 100 * std::pow(albedo - 0.33, 4);
  return albedo * s * (std::exp(-s * r) + std::exp(-s * r / 3)) / (8 * pi);
}

TEST(Burley, TransformIsTheHankelTransformOfThePublishedProfile) {
  const Burley burley(1.4);
  for (const double albedo : {0.01, 0.2, 0.33, 0.6, 0.95, 1.0})
    for (const double k_times_l_d : {0.0, 0.3, 1.0, 5.0, 30.0}) {
      SCOPED_TRACE(::testing::Message() << "A " << albedo << " k l_d " << k_times_l_d);
      const double hankel =
          2 * pi *
          integrate(
              [&](double r) {
                return burley_profile_times_r(albedo, r) * std::cyl_bessel_j(0, k_times_l_d * r);
              },
              0, 3 * 34 / burley_scale(albedo), 600);
      EXPECT_NEAR(transform_at(burley, albedo, k_times_l_d), hankel, 1e-9 * albedo);
    }
}

// Christensen and Burley: <r> = 2.5 d for the profile as a density over radii.
TEST(Burley, HasThePublishedEnergyAndMeanRadius) {
  const Burley burley(1.4);
  for (const double albedo : {0.05, 0.4, 0.9}) {
    EXPECT_NEAR(transform_at(burley, albedo, 0), albedo, 1e-15);
    const double s = burley_scale(albedo), last = 3 * 40 / s;
    const double mean_radius =
        2 * pi / albedo *
        integrate([&](double r) { return r * burley_profile_times_r(albedo, r); }, 0, last, 500);
    EXPECT_NEAR(mean_radius * s, 2.5, 1e-9);
    // The transform knows the mean square radius: R~(k) = A (1 - k^2 <r^2> / 4 ...), <r^2> = 14
    // d^2.
    const double k = 1e-3 * s;
    EXPECT_NEAR((1 - transform_at(burley, albedo, k) / albedo) * 4 / (k * k) * s * s, 14, 1e-3);
  }
}

TEST(Gaussians, TransformIsTheHankelTransformOfTheirSum) {
  const Gaussians gaussians(1.4);
  for (const double albedo : {0.05, 0.4, 0.9}) {
    const double scale = 1 / burley_scale(albedo);
    EXPECT_NEAR(transform_at(gaussians, albedo, 0), albedo, 1e-9);
    for (const double k_times_l_d : {0.4, 3.0, 20.0}) {
      double hankel = 0;
      for (const Gaussian& part : profile_gaussians()) {
        const double variance = part.variance * scale * scale, sigma = std::sqrt(variance);
        hankel += part.weight * integrate(
                                    [&](double r) {
                                      return r / variance * std::exp(-0.5 * r * r / variance) *
                                             std::cyl_bessel_j(0, k_times_l_d * r);
                                    },
                                    0, 9 * sigma, 300);
      }
      EXPECT_NEAR(transform_at(gaussians, albedo, k_times_l_d), albedo * hankel, 1e-10);
    }
  }
}

// What the header says of the fit: its error, and that no neighbouring set of Gaussians is better.
TEST(Gaussians, AreTheLeastSquaresFitToNormalizedDiffusion) {
  std::vector<double> frequencies{0};
  for (int i = 0; i < 200; ++i) frequencies.push_back(0.01 * std::pow(2000.0, i / 199.0));
  const auto error_at = [](const auto& gaussians, double k) {
    double sum = 0;
    for (const Gaussian& part : gaussians)
      sum += part.weight * std::exp(-0.5 * part.variance * k * k);
    return sum / (0.25 / std::sqrt(1 + k * k) + 0.25 / std::sqrt(1.0 / 9 + k * k)) - 1;
  };
  const auto rms_of = [&](const auto& gaussians) {
    double squares = 0;
    for (const double k : frequencies) squares += std::pow(error_at(gaussians, k), 2);
    return std::sqrt(squares / static_cast<double>(frequencies.size()));
  };
  const double rms = rms_of(profile_gaussians());
  EXPECT_NEAR(rms, 0.00682, 1e-5);
  for (const double k : frequencies) EXPECT_LT(std::abs(error_at(profile_gaussians(), k)), 0.025);
  for (const double step : {-1e-3, 1e-3}) {
    for (std::size_t i = 1; i < profile_gaussians().size(); ++i) {
      auto moved = profile_gaussians();
      moved[i].weight += step;
      moved[i - 1].weight -= step;
      EXPECT_GT(rms_of(moved), rms);
    }
    auto wider = profile_gaussians(), spread = wider;
    for (std::size_t i = 0; i < wider.size(); ++i) {
      wider[i].variance *= 1 + step;
      spread[i].variance *= std::pow(1 + step, static_cast<double>(i));
    }
    EXPECT_GT(rms_of(wider), rms);
    EXPECT_GT(rms_of(spread), rms);
  }
}

TEST(RendererProfiles, CoefficientsAreTheDipolesOfTheSameReflectanceAndTranslucency) {
  std::mt19937_64 random(4);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (int draw = 0; draw < 200; ++draw) {
    const Coefficients truth{std::pow(10.0, -3 + 4 * uniform()),
                             std::pow(10.0, -1 + 2 * uniform())};
    const double reflectance = dipole_reflectance(truth, 1.3);
    const double l_d_mm = diffuse_mean_free_path_mm(truth);
    for (const Coefficients& found : {Burley(1.3).coefficients(reflectance, l_d_mm),
                                      Gaussians(1.3).coefficients(reflectance, l_d_mm)}) {
      EXPECT_NEAR(found.sigma_a_per_mm / truth.sigma_a_per_mm, 1, 1e-9);
      EXPECT_NEAR(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm, 1, 1e-9);
    }
  }
}

TEST(RendererProfiles, AreFoundByName) {
  for (const char* name : {"burley", "gaussians"}) {
    const auto model = make_scattering_model(name, {});
    ASSERT_TRUE(model) << model.error().text();
    EXPECT_EQ((*model)->name(), name);
  }
}

}  // namespace
}  // namespace estimation
