// Noise of merged samples: against simulated photons, and found again in the data.
#include "estimation/radiometry/noise.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>

#include "estimation/radiometry/illumination.h"
#include "estimation/radiometry/merge.h"

namespace estimation {
namespace {

// Sum of twelve uniforms: near enough to normal, and the same in every library.
double normal(std::mt19937_64& random) {
  double sum = -6;
  for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11) * 0x1p-53;
  return sum;
}

constexpr SensorNoise kSensor{.gain_e_per_dn = 4.88, .read_noise_e = 10};
constexpr double kBlackDn = 64, kSaturationDn = 4000;

std::uint16_t exposed(double rate_dn_per_us, double exposure_us, std::mt19937_64& random) {
  const double electrons = rate_dn_per_us * exposure_us * kSensor.gain_e_per_dn;
  const double noisy = electrons + normal(random) * std::sqrt(electrons + kSensor.read_noise_e *
                                                                              kSensor.read_noise_e);
  return static_cast<std::uint16_t>(
      std::clamp(std::lround(kBlackDn + noisy / kSensor.gain_e_per_dn), 0L, 4095L));
}

TEST(MergedNoise, PredictsTheScatterOfMergedSamples) {
  const std::vector<double> exposures_us{16667, 66667};
  const std::vector<MergedNoise> noise =
      merged_noise(exposures_us, kSensor, kSaturationDn - kBlackDn);
  ASSERT_EQ(noise.size(), 2U);
  std::mt19937_64 random(1);
  for (const double rate : {0.0005, 0.02, 0.15}) {  // the last clips the long exposure
    SCOPED_TRACE(rate);
    double sum = 0, squares = 0;
    constexpr int kCount = 4000;
    for (int i = 0; i < kCount; ++i) {
      Image<std::uint16_t> a(1, 1), b(1, 1);
      a.at(0, 0) = exposed(rate, exposures_us[0], random);
      b.at(0, 0) = exposed(rate, exposures_us[1], random);
      const ExposedFrame frames[] = {{exposures_us[0], a.view()}, {exposures_us[1], b.view()}};
      const double merged = static_cast<double>(
          merge_brackets(frames, CameraBlack(kBlackDn), kSaturationDn, {}).at(0, 0));
      sum += merged;
      squares += merged * merged;
    }
    const double mean = sum / kCount;
    EXPECT_NEAR(mean / rate, 1, 0.02);
    // 4000 draws tell a variance to 2.2%.
    EXPECT_NEAR((squares / kCount - mean * mean) / variance_at(noise, rate), 1, 0.1);
  }
}

TEST(MergedNoise, OfUnlikeBracketsIsTheirMeanAtEverySignal) {
  const double headroom_dn = kSaturationDn - kBlackDn;
  const std::vector<MergedNoise> both = merged_noise({16667, 66667}, kSensor, headroom_dn);
  const std::vector<MergedNoise> brief = merged_noise({16667}, kSensor, headroom_dn);
  const SharedNoise kinds[] = {{both, 30}, {brief, 10}};
  const std::vector<MergedNoise> mean = mean_noise(kinds);
  for (const double rate : {0.0, 0.01, 0.05, 0.1, 0.2}) {  // the long exposure clips at 0.059
    SCOPED_TRACE(rate);
    EXPECT_NEAR(variance_at(mean, rate),
                0.75 * variance_at(both, rate) + 0.25 * variance_at(brief, rate),
                1e-9 * variance_at(brief, rate));
  }
}

TEST(MergedNoise, BackgroundThatWasSubtractedAddsItsShotNoise) {
  const std::vector<MergedNoise> plain =
      merged_noise({16667, 66667}, kSensor, kSaturationDn - kBlackDn);
  const std::vector<MergedNoise> above = above_background(plain, 0.03);
  for (const double rate : {0.0, 0.01, 0.05, 0.1}) {
    SCOPED_TRACE(rate);
    EXPECT_NEAR(variance_at(above, rate), variance_at(plain, rate + 0.03),
                1e-9 * variance_at(plain, rate + 0.03));
  }
}

TEST(MergedNoise, TellsTheSensorItIsOf) {
  const std::vector<double> exposures_us{66667, 16667};
  const auto sensor =
      sensor_of(merged_noise(exposures_us, kSensor, kSaturationDn - kBlackDn)[0], exposures_us);
  ASSERT_TRUE(sensor);
  EXPECT_NEAR(sensor->gain_e_per_dn, kSensor.gain_e_per_dn, 1e-9);
  EXPECT_NEAR(sensor->read_noise_e, kSensor.read_noise_e, 1e-9);
  EXPECT_FALSE(sensor_of({.read_variance = 1}, exposures_us));
}

TEST(MergedNoise, IsFoundInTheScatterOfAdjacentShifts) {
  std::mt19937_64 random(2);
  const double read_sd = 1e-4, shot = 2e-6;
  std::vector<Image<float>> shifts(40, Image<float>(30, 40));
  std::vector<ImageView<const float>> views;
  for (int row = 0; row < 30; ++row)
    for (int col = 0; col < 40; ++col)
      for (std::size_t i = 0; i < shifts.size(); ++i) {
        const double signal =
            0.002 * col * (1 + 0.5 * std::cos(2 * 3.14159 * (static_cast<double>(i) - row) / 40));
        shifts[i].at(row, col) = static_cast<float>(
            signal + normal(random) * std::sqrt(read_sd * read_sd + shot * signal));
      }
  for (const Image<float>& shift : shifts) views.push_back(shift.view());
  const double no_limit = std::numeric_limits<double>::infinity();
  const auto noise = noise_from_stripes(views, no_limit);
  ASSERT_TRUE(noise);
  EXPECT_NEAR(noise->shot_dn_per_us / shot, 1, 0.2);
  EXPECT_LT(noise->read_variance, 10 * read_sd * read_sd);
  EXPECT_GT(noise->read_variance, 0.5 * read_sd * read_sd);
  EXPECT_FALSE(noise_from_stripes(std::span(views).first(5), no_limit));
}

TEST(MergedNoise, IsFoundWhereAllPixelsAreAlike) {
  std::mt19937_64 random(3);
  const double read_sd = 1e-3, shot = 2e-5, limit = 0.4;
  std::vector<Image<float>> shifts(40, Image<float>(30, 40));
  std::vector<ImageView<const float>> views;
  for (std::size_t i = 0; i < shifts.size(); ++i)
    for (float& sample : shifts[i].samples()) {
      const double signal = 0.25 + 0.2 * std::cos(2 * 3.14159 * (static_cast<double>(i) - 20) / 40);
      const double lost = signal > limit ? 16 : 1;  // a long exposure
      sample = static_cast<float>(
          signal + normal(random) * std::sqrt(lost * (read_sd * read_sd + shot * signal)));
    }
  for (const Image<float>& shift : shifts) views.push_back(shift.view());
  const auto noise = noise_from_stripes(views, limit);
  ASSERT_TRUE(noise);
  for (const double signal : {0.05, 0.25, 0.4}) {
    SCOPED_TRACE(signal);
    const double variance = read_sd * read_sd + shot * signal;
    EXPECT_NEAR((noise->read_variance + noise->shot_dn_per_us * signal) / variance, 1, 0.2);
  }
}

TEST(Illumination, FollowsCosineDistanceAndVignetting) {
  Illumination light;
  EXPECT_DOUBLE_EQ(light.at(1, 1, 0.5, 700), 0.5);
  light.reference_distance_mm = 1000;
  EXPECT_DOUBLE_EQ(light.at(1, 1, 0.5, 2000), 0.125);
  Image<float> vignetting(2, 2, 1, 1.0F);
  vignetting.at(0, 1) = 0.5F;
  light.vignetting = vignetting.view();
  EXPECT_DOUBLE_EQ(light.at(0.5, 0, 1, 1000), 0.75);
  EXPECT_DOUBLE_EQ(light.at(9, -9, 1, 1000), 0.5);  // continued by the border
  EXPECT_DOUBLE_EQ(light.at(1, std::nan(""), 1, 1000), 0.75);
}

}  // namespace
}  // namespace estimation
