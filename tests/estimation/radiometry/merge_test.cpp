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

// Every length and alignment of a row, so that whole vectors and what is left of them are both
// held to the definition.
TEST(BracketMerge, RowsOfAnyLengthFollowTheDefinitionToTheLastTwoBits) {
  std::mt19937_64 random(2);
  for (int width = 1; width < 70; ++width) {
    SCOPED_TRACE(width);
    Image<std::uint16_t> low(3, width), high(3, width);
    Image<float> flat(3, width);
    for (auto& dn : low.samples()) dn = static_cast<std::uint16_t>(random() % 4096);
    for (auto& dn : high.samples()) dn = static_cast<std::uint16_t>(random() % 5000);
    for (auto& gain : flat.samples()) gain = 0.5F + static_cast<float>(random() % 1000) / 1000;
    const ExposedFrame frames[] = {{1000, low.view()}, {4000, high.view()}};
    const Image<float> rate =
        merge_brackets(frames, CameraBlack(63.25), kSaturationDn, flat.view());
    for (std::size_t i = 0; i < rate.samples().size(); ++i) {
      double sum_dn = 0, sum_us = 0;
      for (const auto& [dn, exposure_us] :
           {std::pair{low.samples()[i], 1000.0}, std::pair{high.samples()[i], 4000.0}}) {
        if (dn >= kSaturationDn) continue;
        sum_dn += dn - 63.25;
        sum_us += exposure_us;
      }
      if (sum_us == 0) {
        EXPECT_TRUE(std::isnan(rate.samples()[i]));
        continue;
      }
      const double expected = sum_dn / sum_us / static_cast<double>(flat.samples()[i]);
      EXPECT_NEAR(rate.samples()[i], expected, std::abs(expected) * 2.4e-7);
    }
  }
}

TEST(BracketMerge, IntoTheCallersImageWritesTheSameBitsAndNothingElse) {
  std::mt19937_64 random(3);
  Image<std::uint16_t> frame(4, 53);
  for (auto& dn : frame.samples()) dn = static_cast<std::uint16_t>(random() % 3900);
  const ExposedFrame frames[] = {{1000, frame.view()}};
  const Image<float> own = merge_brackets(frames, CameraBlack(64), kSaturationDn, {});
  Image<float> wide(4, 60, 1, -1.0F);
  const ImageView<float> part{wide.samples().data() + 3, 4, 53, 1, 60};
  merge_brackets_into(frames, CameraBlack(64), kSaturationDn, {}, part);
  for (int row = 0; row < 4; ++row)
    for (int col = -3; col < 57; ++col)
      EXPECT_EQ(wide.at(row, col + 3), col < 0 || col >= 53 ? -1.0F : own.at(row, col));
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
