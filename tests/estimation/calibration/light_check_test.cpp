#include "estimation/calibration/light_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "estimation/calibration/color_fit.h"

namespace estimation {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

LightPair pair(double drive_frac, double rate) {
  return {drive_frac, 16667, rate, 0.0005, 0.01, 0.0098};
}

std::vector<LightPair> steady(double gamma) {
  std::vector<LightPair> pairs;
  for (int i = 0; i < 4; ++i) {
    pairs.push_back(pair(1, 0.2 * (1 + 1e-4 * (i % 2))));
    pairs.push_back(pair(0, 2e-4));
  }
  for (const double drive : {0.25, 0.5, 0.75})
    pairs.push_back(pair(drive, 2e-4 + (0.2 - 2e-4) * std::pow(drive, gamma)));
  return pairs;
}

TEST(LightCheck, ASteadyProjectorHasItsGammaMeasured) {
  const LightCheck check = check_light(steady(2.2), {});
  EXPECT_THAT(check.warnings, IsEmpty());
  EXPECT_NEAR(check.gamma.value, 2.2, 0.005);
  EXPECT_NEAR(check.white_dn_per_us.value, 0.2, 1e-4);
  EXPECT_NEAR(check.black_dn_per_us.value, 2e-4, 1e-9);
}

TEST(LightCheck, AWhiteThatDriftsIsTold) {
  std::vector<LightPair> pairs = steady(1);
  for (LightPair& each : pairs)
    if (each.drive_frac == 1) each.change_frac = 0.01;
  EXPECT_THAT(check_light(pairs, {}).warnings, Contains(HasSubstr("white is not steady")));
}

TEST(LightCheck, AWhiteThatDriftsFromPairToPairIsTold) {
  std::vector<LightPair> pairs = steady(1);
  for (std::size_t i = 0; i < pairs.size(); ++i)
    if (pairs[i].drive_frac == 1) pairs[i].rate_dn_per_us *= 1 + 0.005 * static_cast<double>(i);
  EXPECT_THAT(check_light(pairs, {}).warnings, Contains(HasSubstr("white is not steady")));
}

TEST(LightCheck, DitheredGreysAreTold) {
  std::vector<LightPair> pairs = steady(1);
  for (LightPair& each : pairs)
    if (each.drive_frac == 0.5) each.scatter_frac = 0.05;
  EXPECT_THAT(check_light(pairs, {}).warnings, Contains(HasSubstr("dithers")));
}

TEST(LightCheck, NothingRepeatedIsNothingMeasured) {
  EXPECT_THAT(check_light({}, {}).warnings, Contains(HasSubstr("was not measured")));
}

const Mat3 kTrueMatrix(1.5, -0.4, -0.1, -0.2, 1.4, -0.2, 0.05, -0.5, 1.45);

TEST(ColorFit, AChartGivesTheMatrixAndKeepsGreysGrey) {
  std::vector<ColorPatch> patches;
  for (int i = 0; i < 24; ++i) {
    const Vec3 camera(0.1 + 0.03 * i, 0.5 + 0.3 * std::sin(i), 0.4 + 0.3 * std::cos(2.0 * i));
    patches.push_back({camera, kTrueMatrix * camera});
  }
  const auto fit = fit_color_matrix(patches);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_LT(cv::norm(fit->matrix - kTrueMatrix), 1e-9);
  for (std::size_t i = 0; i < patches.size(); ++i)
    patches[i].display[1] += i % 2 == 0 ? 0.01 : -0.01;
  const auto noisy = fit_color_matrix(patches);
  ASSERT_TRUE(noisy);
  const Vec3 grey = noisy->matrix * Vec3(0.3, 0.3, 0.3);
  EXPECT_NEAR(grey[0], 0.3, 1e-12);
  EXPECT_NEAR(grey[1], 0.3, 1e-12);
  EXPECT_NEAR(noisy->residual_rms, 0.01 / std::sqrt(3), 0.002);
  EXPECT_GT(noisy->sd(1, 0), 0);
}

TEST(ColorFit, GreysAloneAreRefused) {
  std::vector<ColorPatch> patches;
  for (int i = 1; i < 8; ++i) patches.push_back({{0.1 * i, 0.1 * i, 0.1 * i}, {0.1, 0.1, 0.1}});
  EXPECT_FALSE(fit_color_matrix(patches));
}

TEST(ColorFit, SingleColoursGiveTheInverseOfTheCrosstalk) {
  const Mat3 crosstalk(0.9, 0.08, 0.02, 0.1, 0.8, 0.1, 0.0, 0.2, 0.8);
  const auto matrix = color_matrix_from_primaries(crosstalk * 3.0);
  ASSERT_TRUE(matrix);
  EXPECT_LT(cv::norm(*matrix * crosstalk - Mat3::eye()), 1e-9);
  EXPECT_FALSE(color_matrix_from_primaries(Mat3(1, 1, 1, 1, 1, 1, 1, 1, 1)));
}

}  // namespace
}  // namespace estimation
