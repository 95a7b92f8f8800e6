#include "estimation/calibration/sensor_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <deque>

#include "tests/estimation/geometry/synthetic_frames.h"

namespace estimation {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::NormalDeviates;

struct SyntheticSensor {
  double gain_e_per_dn = 4.88, read_noise_e = 10, black_dn = 64;
  double dark_dn_per_us = 0;
  double compression = 0;  // at full scale
  int height_px = 400, width_px = 600;
};

constexpr double kSaturationDn = 4000;

// A steady scene from dark to bright, sampled by the sensor; each frame with noise of its own.
class Series {
 public:
  explicit Series(const SyntheticSensor& sensor) : sensor_(sensor), deviates_(7) {}

  // `light` by site of a 2 x 2 mosaic.
  using MosaicLight = std::array<double, 4>;
  void add(double exposure_us, bool is_dark, const MosaicLight& light = {1, 1, 1, 1}) {
    Image<std::uint16_t>& dn = images_.emplace_back(sensor_.height_px, sensor_.width_px);
    for (int row = 0; row < sensor_.height_px; ++row)
      for (int col = 0; col < sensor_.width_px; ++col) {
        const double own = light[static_cast<std::size_t>(2 * (row % 2) + col % 2)];
        const double rate = is_dark ? 0 : own * 0.24 * (0.05 + 0.95 * col / sensor_.width_px);
        double signal = rate * exposure_us + sensor_.dark_dn_per_us * exposure_us;
        signal *= 1 - sensor_.compression * signal / kSaturationDn;
        const double electrons = signal * sensor_.gain_e_per_dn;
        const double sd = std::hypot(std::sqrt(electrons), sensor_.read_noise_e);
        const double value =
            sensor_.black_dn + (electrons + sd * deviates_.next()) / sensor_.gain_e_per_dn;
        dn.at(row, col) = static_cast<std::uint16_t>(std::clamp(std::lround(value), 0L, 4095L));
      }
    frames_.push_back({exposure_us, is_dark, dn.view()});
  }
  void add_usual() {
    for (const double exposure_us : {1000.0, 8000.0, 16000.0})
      for (int i = 0; i < 4; ++i) add(exposure_us, true);
    for (const double exposure_us : {1000.0, 2000.0, 4000.0, 8000.0, 12000.0, 16000.0})
      for (int i = 0; i < 4; ++i) add(exposure_us, false);
  }
  const std::vector<SeriesFrame>& frames() const { return frames_; }

 private:
  SyntheticSensor sensor_;
  NormalDeviates deviates_;
  std::deque<Image<std::uint16_t>> images_;  // addresses stay
  std::vector<SeriesFrame> frames_;
};

TEST(SensorFit, FindsBlackGainAndReadNoiseToHalfAPercent) {
  const SyntheticSensor truth;
  Series series(truth);
  series.add_usual();
  const auto fit = fit_sensor(series.frames(), kSaturationDn);
  ASSERT_TRUE(fit) << fit.error().text();
  std::printf("gain %.4f +- %.4f, read noise %.3f +- %.3f, black %.3f +- %.3f, linearity %.5f\n",
              fit->gain_e_per_dn.value, fit->gain_e_per_dn.sd, fit->read_noise_e.value,
              fit->read_noise_e.sd, fit->black_level_dn.value, fit->black_level_dn.sd,
              fit->linearity_max_frac.value);
  EXPECT_NEAR(fit->gain_e_per_dn.value / truth.gain_e_per_dn, 1, 0.005);
  EXPECT_NEAR(fit->read_noise_e.value / truth.read_noise_e, 1, 0.005);
  EXPECT_NEAR(fit->black_level_dn.value, truth.black_dn, 0.02);
  EXPECT_LT(fit->linearity_max_frac.value, 0.001);
  EXPECT_LT(std::abs(fit->gain_e_per_dn.value - truth.gain_e_per_dn), 4 * fit->gain_e_per_dn.sd);
  EXPECT_LT(std::abs(fit->read_noise_e.value - truth.read_noise_e), 4 * fit->read_noise_e.sd);
  EXPECT_THAT(fit->warnings, IsEmpty());
}

TEST(SensorFit, DriftOfTheLightIsNoNoise) {
  const SyntheticSensor truth;
  Series series(truth);
  for (int i = 0; i < 2; ++i) series.add(4000, true);
  for (const double exposure_us : {4000.0, 12000.0})
    for (int i = 0; i < 8; ++i) {
      const double light = 1 + 0.01 * (i % 2);
      series.add(exposure_us, false, {light, light, light, light});
    }
  const auto fit = fit_sensor(series.frames(), kSaturationDn);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_NEAR(fit->gain_e_per_dn.value / truth.gain_e_per_dn, 1, 0.01);
}

// The mean over all colours is steady.
TEST(SensorFit, AColourWheelsDriftIsNoNoise) {
  const SyntheticSensor truth;
  Series series(truth);
  for (int i = 0; i < 2; ++i) series.add(4000, true);
  for (const double exposure_us : {4000.0, 12000.0})
    for (int i = 0; i < 8; ++i) {
      const double turn = i % 2 == 0 ? 0.02 : -0.02;
      series.add(exposure_us, false, {1 + turn, 1, 1, 1 - turn});
    }
  const auto fit = fit_sensor(series.frames(), kSaturationDn);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_NEAR(fit->gain_e_per_dn.value / truth.gain_e_per_dn, 1, 0.01);
}

TEST(SensorFit, TellsACameraThatIsNotLinear) {
  SyntheticSensor truth;
  truth.compression = 0.04;
  Series series(truth);
  series.add_usual();
  const auto fit = fit_sensor(series.frames(), kSaturationDn);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_GT(fit->linearity_max_frac.value, 0.01);
  EXPECT_LT(fit->linearity_max_frac.value, 0.04);
  EXPECT_THAT(fit->warnings, Contains(HasSubstr("linearity")));
}

TEST(SensorFit, ADarkSignalGrowsWithExposure) {
  SyntheticSensor truth;
  truth.dark_dn_per_us = 2e-4;
  Series series(truth);
  series.add_usual();
  const auto fit = fit_sensor(series.frames(), kSaturationDn);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_NEAR(fit->dark_signal_dn_per_us.value, 2e-4, 4e-6);
  EXPECT_NEAR(fit->black_level_dn.value, truth.black_dn, 0.03);
}

TEST(SensorFit, SaysWhatIsMissing) {
  Series dark{SyntheticSensor{}};
  dark.add(1000, true);
  EXPECT_THAT(fit_sensor(dark.frames(), kSaturationDn).error().text(), HasSubstr("no lit frame"));
  Series lit{SyntheticSensor{}};
  lit.add(1000, false);
  EXPECT_THAT(fit_sensor(lit.frames(), kSaturationDn).error().text(), HasSubstr("cap the lens"));
  Series single{SyntheticSensor{}};
  single.add(1000, true);
  single.add(8000, false);
  EXPECT_THAT(fit_sensor(single.frames(), kSaturationDn).error().text(),
              HasSubstr("two frames or more of the same exposure"));
}

}  // namespace
}  // namespace estimation
