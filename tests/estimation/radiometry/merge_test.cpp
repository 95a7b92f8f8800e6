// Exposure brackets to linear signals.
#include "estimation/radiometry/merge.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace estimation {
namespace {

constexpr double kSaturationDn = 4000;

Image<std::uint16_t> frame_of(std::uint16_t dn) { return {1, 1, 1, dn}; }

float merged(const std::vector<std::pair<double, int>>& exposures, double black_dn = 64,
             ImageView<const float> flat = {}) {
  std::vector<Image<std::uint16_t>> images;
  for (const auto& exposure : exposures)
    images.push_back(frame_of(static_cast<std::uint16_t>(exposure.second)));
  std::vector<ExposedFrame> frames;
  for (std::size_t i = 0; i < images.size(); ++i)
    frames.push_back({exposures[i].first, images[i].view()});
  return merge_brackets(frames, CameraBlack(black_dn), kSaturationDn, flat).at(0, 0);
}

TEST(BracketMerge, IsTheRatioOfSignalAndTimeSums) {
  EXPECT_FLOAT_EQ(merged({{1000, 164}, {4000, 470}}), (100.0F + 406.0F) / 5000.0F);
  EXPECT_FLOAT_EQ(merged({{1000, 164}}), 0.1F);
}

TEST(BracketMerge, DuplicateExposuresAreBothUsed) {
  EXPECT_FLOAT_EQ(merged({{1000, 164}, {1000, 166}}), 0.101F);
}

TEST(BracketMerge, SaturatedSamplesAreLeftOut) {
  EXPECT_FLOAT_EQ(merged({{1000, 3064}, {4000, 4095}}), 3.0F);
  EXPECT_FLOAT_EQ(merged({{1000, 3064}, {4000, 4000}}), 3.0F);  // from the level on
  EXPECT_FLOAT_EQ(merged({{1000, 64}, {4000, 3999}}), 0.787F);  // just below it
}

TEST(BracketMerge, SaturatedEverywhereIsNotANumber) {
  EXPECT_TRUE(std::isnan(merged({{1000, 4000}, {4000, 4095}})));
}

TEST(BracketMerge, BelowBlackIsNegativeAndNotClipped) {
  EXPECT_FLOAT_EQ(merged({{1000, 54}}), -0.01F);  // clipping would brighten the dark
}

TEST(BracketMerge, FlatFieldDivides) {
  const Image<float> half(1, 1, 1, 0.5F), zero(1, 1, 1, 0.0F);
  EXPECT_FLOAT_EQ(merged({{1000, 164}}, 64, half.view()), 0.2F);
  EXPECT_TRUE(std::isnan(merged({{1000, 164}}, 64, zero.view())));
}

TEST(BracketMerge, OrderOfFramesDoesNotChangeABit) {
  std::mt19937_64 random(1);
  for (int draw = 0; draw < 200; ++draw) {
    std::vector<std::pair<double, int>> exposures;
    for (const double exposure_us : {1000.0, 3300.0, 12000.0})
      exposures.emplace_back(exposure_us, static_cast<int>(random() % 4096));
    const float forward = merged(exposures, 63.7);
    std::swap(exposures[0], exposures[2]);
    const float backward = merged(exposures, 63.7);
    if (std::isnan(forward))
      EXPECT_TRUE(std::isnan(backward));
    else
      EXPECT_EQ(forward, backward);
  }
}

TEST(BracketMerge, MergesEachChannelOfAnRgbFrame) {
  Image<std::uint16_t> frame(1, 1, 3);
  frame.at(0, 0, 0) = 164;
  frame.at(0, 0, 1) = 264;
  frame.at(0, 0, 2) = 4095;
  const ExposedFrame frames[] = {{1000, frame.view()}};
  const Image<float> flat(1, 1, 1, 2.0F);
  const Image<float> rate = merge_brackets(frames, CameraBlack(64), kSaturationDn, flat.view());
  EXPECT_FLOAT_EQ(rate.at(0, 0, 0), 0.05F);
  EXPECT_FLOAT_EQ(rate.at(0, 0, 1), 0.1F);
  EXPECT_TRUE(std::isnan(rate.at(0, 0, 2)));
}

TEST(CameraBlack, DarkFramesAreInterpolatedInTimeAndTheEndsHold) {
  std::vector<CameraBlack::Dark> darks;
  darks.push_back({4000, frame_of(80)});  // any order
  darks.push_back({1000, frame_of(60)});
  darks.push_back({1000, frame_of(62)});  // averaged with the one before
  const CameraBlack black(std::move(darks));
  const auto at = [&](double exposure_us) {
    float dn = 0;
    black.row(exposure_us, 0, {&dn, 1});
    return dn;
  };
  EXPECT_FLOAT_EQ(at(100), 61);
  EXPECT_FLOAT_EQ(at(1000), 61);
  EXPECT_FLOAT_EQ(at(2500), 70.5F);
  EXPECT_FLOAT_EQ(at(4000), 80);
  EXPECT_FLOAT_EQ(at(90000), 80);
  EXPECT_DOUBLE_EQ(black.mean_dn(2500), 70.5);
}

}  // namespace
}  // namespace estimation
