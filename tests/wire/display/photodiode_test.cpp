#include "hw_sim/display/photodiode.h"

#include <gtest/gtest.h>

#include <cmath>

#include "hw_sim/display/picture_cache.h"
#include "hw_sim/display/scanout_clock.h"

namespace {

using hw_sim::LevelSample;
using hw_sim::Photodiode;
using namespace std::chrono_literals;

const rig::HostTime kStart{1s};

TEST(Photodiode, WithoutTimeConstantsReadsAtOnce) {
  Photodiode photodiode({.dark_adc = 50, .light_adc = 850});
  const std::vector<LevelSample> samples = photodiode.look(kStart, 0.25);
  ASSERT_EQ(samples.size(), 1U);
  EXPECT_EQ(samples[0].time, kStart);
  EXPECT_EQ(samples[0].level_adc, 250);
}

TEST(Photodiode, InvertedReadsLightAsLow) {
  Photodiode photodiode({.dark_adc = 50, .light_adc = 850, .is_inverted = true});
  EXPECT_EQ(photodiode.look(kStart, 1).back().level_adc, 50);
  EXPECT_EQ(photodiode.look(kStart + 1s, 0).back().level_adc, 850);
}

TEST(Photodiode, ApproachesByItsOwnConstantEachWay) {
  Photodiode photodiode(
      {.dark_adc = 0, .light_adc = 1000, .rise_time = 1000us, .fall_time = 4000us});
  for (const LevelSample& sample : photodiode.look(kStart, 1)) {
    EXPECT_GT(sample.time, kStart);
    const double elapsed = std::chrono::duration<double>(sample.time - kStart) / 1ms;
    EXPECT_NEAR(sample.level_adc, 1000 * (1 - std::exp(-elapsed)), 8);
  }
  const std::vector<LevelSample> fall = photodiode.look(kStart + 1s, 0);
  EXPECT_EQ(fall.back().time, kStart + 1s + 20ms);
  EXPECT_EQ(fall.back().level_adc, 0);
  EXPECT_NEAR(fall[3].level_adc, 1000 * std::exp(-1.0), 1);
}

TEST(Photodiode, TurnsFromWhereItWas) {
  Photodiode photodiode(
      {.dark_adc = 0, .light_adc = 1000, .rise_time = 1000us, .fall_time = 1000us});
  photodiode.look(kStart, 1);
  const std::vector<LevelSample> back = photodiode.look(kStart + 1ms, 0);  // at 1 - 1/e
  EXPECT_NEAR(back[3].level_adc, 1000 * (1 - std::exp(-1.0)) * std::exp(-1.0), 1);
}

TEST(PictureCache, SameContentIsTheSamePictureUntilForgotten) {
  hw_sim::PictureCache cache(2);
  const auto plain = [](unsigned char level) {
    return estimation::Image<unsigned char>(3, 4, 1, level);
  };
  const auto one = cache.find(plain(1));
  const auto two = cache.find(plain(2));
  EXPECT_NE(one->id, two->id);
  EXPECT_EQ(cache.find(plain(1)), one);  // now two is the oldest
  const auto three = cache.find(plain(3));
  EXPECT_EQ(cache.find(plain(1)), one);
  const auto two_again = cache.find(plain(2));
  EXPECT_NE(two_again->id, two->id);
  EXPECT_NE(two_again->id, three->id);
}

TEST(ScanoutClock, BlankOfItsOwnTimeIsItself) {
  for (const double refresh_hz : {59.94, 60.0, 120.0, 144.0}) {
    const hw_sim::ScanoutClock clock(refresh_hz);
    for (std::int64_t blank = 1'000'000; blank < 1'001'000; ++blank) {
      EXPECT_EQ(clock.blank_at(clock.time_of(blank)), blank);
      EXPECT_EQ(clock.blank_at(clock.time_of(blank) - 1ns), blank - 1);
    }
  }
}

}  // namespace
