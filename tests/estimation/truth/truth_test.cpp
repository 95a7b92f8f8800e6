// The truth generators against what is known without them.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <numeric>

#include "estimation/models/dipole.h"
#include "tests/estimation/profile/synthetic_profile.h"
#include "tests/estimation/truth/line_spread.h"
#include "tests/estimation/truth/monte_carlo_truth.h"
#include "tests/estimation/truth/sensor.h"
#include "tests/estimation/truth/stripe_response.h"

namespace estimation::truth {
namespace {

using estimation::testing::kCheekRed;
using estimation::testing::kStubbleBlue;

constexpr double kEta = 1.4;
const std::vector<Coefficients> kMedia{
    {0.0525, 1.2814}, {0.6707, 0.6648}, {0.0002, 7.38}, {1e-6, 1}, {3, 0.05}};

// The dipole is the field of two sources; Gauss and eq. 5 give its integral over the plane.
TEST(LineSpread, WholePlaneGivesEquation5) {
  for (const Coefficients& medium : kMedia) {
    const DipoleLineSpread truth(medium, kEta);
    const double expected = dipole_reflectance(medium, kEta);
    EXPECT_NEAR(truth.diffuse_reflectance() / expected, 1, 1e-12) << medium.sigma_a_per_mm;
    EXPECT_NEAR(truth.beyond(-1) + truth.beyond(1), expected, 1e-12 * expected);
  }
}

// A line of the dipole is a pair of line charges: alpha'/(2 pi) sigma z/rho K1(sigma rho).
TEST(LineSpread, QuadratureIsTheBesselFunctionThatTablesGive) {
  const Coefficients medium{0.0525, 1.2814};
  const double extinction = 0.0525 + 1.2814, sigma_tr = std::sqrt(3 * 0.0525 * extinction);
  const double z_r = 1 / extinction, z_v = z_r * (1 + 4 * boundary_factor(kEta) / 3);
  const DipoleLineSpread truth(medium, kEta);
  for (const double x_mm : {0.0, 0.1, 1.0, 10.0, 40.0}) {
    double expected = 0;
    for (const double z : {z_r, z_v}) {
      const double rho = std::hypot(x_mm, z);
      expected += sigma_tr * z / rho * std::cyl_bessel_k(1, sigma_tr * rho);
    }
    expected *= 1.2814 / extinction / (2 * std::numbers::pi);
    EXPECT_NEAR(truth.line_spread_per_mm(x_mm) / expected, 1, 1e-12) << x_mm;
  }
}

// Two routes to the same signal: sums in space here, sums of 3000 harmonics there.
TEST(StripeResponse, SpaceAndFrequencyAgree) {
  for (const auto& skin : {kCheekRed, kStubbleBlue})
    for (const double pitch_mm : {0.15, 0.3, 0.6}) {
      const DipoleLineSpread truth(skin.medium, kEta);
      const auto stripes = estimation::testing::paper_stripes();
      const auto expected =
          estimation::testing::reflectance_factors(stripes, skin.medium, kEta, pitch_mm, 123.4, 0);
      const PeriodicCurve curve(stripes.shape.period_px, [&](double x_px) {
        return dipole_response(truth, stripes.shape, pitch_mm, x_px);
      });
      const std::vector<double> seen =
          sweep(curve, stripes.shape, stripes.shifts_px, {.u_px = 123.4});
      for (std::size_t i = 0; i < seen.size(); ++i) {
        const double x_px = 123.4 - stripes.shifts_px[i] - 3.5;
        EXPECT_NEAR(dipole_response(truth, stripes.shape, pitch_mm, x_px), expected[i], 1e-10);
        EXPECT_NEAR(seen[i], expected[i], 1e-10) << "interpolated";
      }
    }
}

TEST(StripeResponse, BlurMultipliesHarmonicsByAGaussian) {
  const double sigma_px = 1.3;
  const PeriodicCurve wave(40, [](double x_px) {
    return 0.3 + 0.1 * std::cos(2 * std::numbers::pi * 3 * x_px / 40 - 0.4);
  });
  const double k = 2 * std::numbers::pi * 3 / 40,
               contrast = std::exp(-0.5 * std::pow(k * sigma_px, 2));
  const PeriodicCurve blurred = wave.blurred(sigma_px);
  for (const double x_px : {0.0, 7.77, -3.2, 55.5})
    EXPECT_NEAR(blurred(x_px), 0.3 + 0.1 * contrast * std::cos(k * x_px - 0.4), 1e-10);
}

TEST(Sweep, DriftMovesTheLastFrameAgainstTheFirst) {
  const PeriodicCurve ramp(40, [](double x_px) { return x_px; });  // away from its jump
  const std::vector<int> shifts(5, 0);
  const auto seen = sweep(ramp, {}, shifts, {.u_px = 20, .drift_px = 0.5});
  EXPECT_NEAR(seen.back() - seen.front(), 0.5, 1e-9);
  EXPECT_NEAR(seen[2], 16.5, 1e-9);
  const std::vector<int> order{4, 3, 2, 1, 0};
  const auto reversed = sweep(ramp, {}, shifts, {.u_px = 20, .drift_px = 0.5}, order);
  EXPECT_NEAR(reversed.back() - reversed.front(), -0.5, 1e-9);
}

// The merged sample's mean is the signal, its variance what merged_noise says: below, at and above
// the signal at which the long exposure saturates.
TEST(Sensor, MeanAndVarianceAreWhatTheNoiseModelSays) {
  for (const double light_frac : {1.0, 1.0 / 16}) {
    const Sensor sensor{.light_frac = light_frac};
    for (const double factor : {0.02, 0.1, 0.2, 0.5}) {
      PixelRandom random(7);
      constexpr int kCount = 20000;
      double sum = 0, squares = 0;
      const double expected = factor * sensor.full_signal_dn_per_us();
      for (int i = 0; i < kCount; ++i) {
        const double error = sensor.read(factor, random) - expected;
        sum += error;
        squares += error * error;
      }
      const double variance = variance_at(sensor.noise(), expected);
      EXPECT_NEAR(sum / kCount, 0, 4 * std::sqrt(variance / kCount));
      EXPECT_NEAR(squares / kCount / variance, 1, 0.05) << factor << " " << light_frac;
    }
  }
}

TEST(MonteCarloTruth, ReadsWhatTheFileSaysAndContinuesItSmoothly) {
  const auto media = read_monte_carlo_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv");
  ASSERT_TRUE(media) << media.error().text();
  ASSERT_EQ(media->size(), 8U);
  const MonteCarloMedium& cheek = (*media)[2];
  EXPECT_EQ(cheek.name, "red_cheek");
  EXPECT_DOUBLE_EQ(cheek.at(0), 0.401846);
  EXPECT_DOUBLE_EQ(cheek.at(0.5), 0.044118);
  EXPECT_NEAR(cheek.at(1.001) / cheek.at(0.999), 1, 0.005);
  EXPECT_LT(cheek.at(4), 0.3 * cheek.at(1));
  EXPECT_FALSE(read_monte_carlo_truth("/nonexistent.csv"));
}

TEST(MonteCarloTruth, TransmissionOfSection1) {
  EXPECT_NEAR(fresnel_transmission(1.4, 1), 0.972, 0.0005);
  EXPECT_NEAR(fresnel_transmission(1.4, std::sqrt(0.5)), 0.963, 0.0005);
  EXPECT_NEAR(fresnel_transmission(1.4, 0.5), 0.928, 0.0005);
}

TEST(MonteCarloTruth, StripesKeepTheMean) {
  const auto media = read_monte_carlo_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv");
  ASSERT_TRUE(media);
  const PeriodicCurve curve = monte_carlo_curve((*media)[2], {}, 0.3, 0.972);
  EXPECT_NEAR(curve.mean(), 0.2 * 0.972 * 0.401846, 1e-12);
  EXPECT_GT(curve(0), 2 * curve(20));
}

}  // namespace
}  // namespace estimation::truth
