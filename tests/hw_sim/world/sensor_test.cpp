#include "hw_sim/world/sensor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace hw_sim {
namespace {

constexpr SensorModel kSensor{64, 4.88, 10, 4095, 7};

std::vector<std::uint16_t> frame_of(const SensorModel& sensor, float signal_dn, int count,
                                    std::uint64_t trigger = 1) {
  const std::vector<float> signal(static_cast<std::size_t>(count), signal_dn);
  std::vector<std::uint16_t> frame(signal.size());
  sensor.digitise(signal.data(), trigger, 0, count, frame.data());
  return frame;
}

struct Moments {
  double mean = 0, variance = 0, skewness = 0;
};
Moments moments_of(const std::vector<std::uint16_t>& frame) {
  Moments m;
  for (const auto v : frame) m.mean += v;
  m.mean /= static_cast<double>(frame.size());
  double third = 0;
  for (const auto v : frame) {
    const double d = v - m.mean;
    m.variance += d * d;
    third += d * d * d;
  }
  m.variance /= static_cast<double>(frame.size());
  m.skewness = third / static_cast<double>(frame.size()) / std::pow(m.variance, 1.5);
  return m;
}

TEST(Sensor, MeanAndVarianceArePoissonPlusReadNoisePlusQuantisation) {
  constexpr int kCount = 400000;
  for (const float signal_dn : {0.0F, 1.0F, 5.0F, 50.0F, 700.0F, 3000.0F}) {
    const double signal = static_cast<double>(signal_dn);
    const double electrons = signal * 4.88;
    const double variance = (electrons + 100) / (4.88 * 4.88) + 1.0 / 12;
    const Moments m = moments_of(frame_of(kSensor, signal_dn, kCount));
    EXPECT_NEAR(m.mean, 64 + signal, 5 * std::sqrt(variance / kCount)) << signal;
    EXPECT_NEAR(m.variance, variance, 5 * variance * std::sqrt(2.0 / kCount)) << signal;
  }
}

TEST(Sensor, FewPhotonsAreCountedNotApproximated) {
  // 1 e/DN and no read noise: the frame is the Poisson count itself.
  const SensorModel counter{0, 1, 0, 4095, 3};
  constexpr int kCount = 400000;
  const double mean = 2.5;
  std::vector<double> histogram(30, 0.0);
  for (const auto v : frame_of(counter, static_cast<float>(mean), kCount))
    ++histogram[std::min<std::size_t>(v, 29)];
  double probability = std::exp(-mean);
  for (std::size_t k = 0; k < 10; ++k) {
    EXPECT_NEAR(histogram[k] / kCount, probability, 5 * std::sqrt(probability / kCount)) << k;
    probability *= mean / static_cast<double>(k + 1);
  }
}

TEST(Sensor, SkewnessIsPoissonsOnBothSidesOfTheSwitch) {
  const SensorModel counter{0, 1, 0, 4095, 5};
  for (const float mean : {25.0F, 40.0F}) {
    const Moments m = moments_of(frame_of(counter, mean, 1000000));
    EXPECT_NEAR(m.skewness, 1 / std::sqrt(static_cast<double>(mean)), 0.02) << mean;
  }
}

TEST(Sensor, ClipsAtTheConverterAndNeverBelowZero) {
  for (const auto v : frame_of(kSensor, 1e6F, 1000)) EXPECT_EQ(v, 4095);
  const SensorModel loud{0, 1, 500, 255, 1};
  bool has_zero = false;
  for (const auto v : frame_of(loud, 0, 1000)) {
    EXPECT_LE(v, 255);
    has_zero = has_zero || v == 0;
  }
  EXPECT_TRUE(has_zero);
}

TEST(Sensor, NoiseDependsOnSeedTriggerAndSampleAlone) {
  const auto frame = frame_of(kSensor, 100, 1000);
  EXPECT_EQ(frame, frame_of(kSensor, 100, 1000));
  EXPECT_NE(frame, frame_of(kSensor, 100, 1000, 2));
  SensorModel other = kSensor;
  other.seed = 8;
  EXPECT_NE(frame, frame_of(other, 100, 1000));
  // In two pieces: the same bytes.
  const std::vector<float> signal(1000, 100.0F);
  std::vector<std::uint16_t> pieces(1000);
  kSensor.digitise(signal.data() + 300, 1, 300, 700, pieces.data() + 300);
  kSensor.digitise(signal.data(), 1, 0, 300, pieces.data());
  EXPECT_EQ(frame, pieces);
}

TEST(Sensor, NeighboursAndTriggersAreUncorrelated) {
  const auto a = frame_of(kSensor, 500, 200000, 1), b = frame_of(kSensor, 500, 200000, 2);
  const Moments m = moments_of(a);
  double neighbours = 0, triggers = 0;
  for (std::size_t i = 1; i < a.size(); ++i) {
    neighbours += (a[i] - m.mean) * (a[i - 1] - m.mean);
    triggers += (a[i] - m.mean) * (b[i] - m.mean);
  }
  const double scale = m.variance * static_cast<double>(a.size());
  EXPECT_NEAR(neighbours / scale, 0, 0.012);
  EXPECT_NEAR(triggers / scale, 0, 0.012);
}

}  // namespace
}  // namespace hw_sim
