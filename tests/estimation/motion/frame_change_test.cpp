// Changes between two showings whose truth is known: a striped head that is a formula.
#include "estimation/motion/frame_change.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <string>
#include <utility>

#include "estimation/motion/brief_change.h"
#include "tests/estimation/motion/striped_head.h"

namespace estimation {
namespace {

using testing::HasSubstr;

FrameChange change_between(const StripedHead& first, const StripedHead& second,
                           const CameraInfo& camera = striped_camera()) {
  const auto change = measure_change(camera, period_px(camera), photograph(first, camera).view(),
                                     photograph(second, camera).view());
  if (change) return *change;
  ADD_FAILURE() << change.error().text();
  return {};
}

void print(const char* what, const FrameChange& change) {
  std::printf(
      "%s: shift %.4f+-%.4f %.4f+-%.4f local %.4f px light %.5f+-%.5f ambient %.5f+-%.5f "
      "residual %.3f places %zu\n",
      what, change.shift_row_px, change.shift_row_sd_px, change.shift_col_px,
      change.shift_col_sd_px, change.local_shift_px, change.light_frac, change.light_sd_frac,
      change.ambient_frac, change.ambient_sd_frac, change.residual_frac,
      change.local_changes.size());
}

TEST(FrameChange, StillSubjectHasNotMovedBeyondItsNoise) {
  const FrameChange change = change_between({}, {.seed = 2});
  print("still", change);
  EXPECT_LT(std::abs(change.shift_row_px), 0.05);
  EXPECT_LT(std::abs(change.shift_col_px), 0.02);
  EXPECT_LT(std::abs(change.light_frac), 0.002);
  EXPECT_LT(std::abs(change.ambient_frac), 0.001);
  EXPECT_LT(change.local_shift_px, 0.05);
  EXPECT_TRUE(change.local_changes.empty());
}

TEST(FrameChange, ShiftsAreFoundWithinTheirUncertainty) {
  std::mt19937_64 random(7);
  const auto uniform = [&random](double low, double high) {
    return low + (high - low) * static_cast<double>(random() >> 11U) * 0x1.0p-53;
  };
  double squares = 0, worst = 0;
  constexpr int kDraws = 40;
  for (int draw = 0; draw < kDraws; ++draw) {
    const StripedHead moved{.shift_row_px = uniform(-4, 4),
                            .shift_col_px = uniform(-4, 4),
                            .seed = 100U + static_cast<unsigned>(draw)};
    SCOPED_TRACE(draw);
    const FrameChange change = change_between({}, moved);
    const double row = (change.shift_row_px - moved.shift_row_px) / change.shift_row_sd_px;
    const double col = (change.shift_col_px - moved.shift_col_px) / change.shift_col_sd_px;
    EXPECT_LT(change.shift_row_sd_px, 0.05);
    EXPECT_LT(change.shift_col_sd_px, 0.02);
    squares += row * row + col * col;
    worst = std::max({worst, std::abs(row), std::abs(col)});
  }
  const double rms = std::sqrt(squares / (2 * kDraws));
  std::printf("errors over sd: rms %.2f, worst %.2f\n", rms, worst);
  EXPECT_GT(rms, 0.4);
  EXPECT_LT(rms, 1.6);
  EXPECT_LT(worst, 5);
}

TEST(FrameChange, FarShiftIsFound) {
  const FrameChange change = change_between({}, {.shift_row_px = 11.3, .shift_col_px = -17.6});
  print("far", change);
  EXPECT_NEAR(change.shift_row_px, 11.3, 0.2);
  EXPECT_NEAR(change.shift_col_px, -17.6, 0.1);
}

TEST(FrameChange, LightIsToldFromAmbient) {
  const FrameChange brighter = change_between({}, {.light = 1.03, .seed = 2});
  print("brighter", brighter);
  EXPECT_NEAR(brighter.light_frac, 0.03, 0.003);
  EXPECT_LT(std::abs(brighter.ambient_frac), 0.003);
  const FrameChange ambient = change_between({}, {.ambient_frac = 0.02, .seed = 3});
  print("ambient", ambient);
  EXPECT_LT(std::abs(ambient.light_frac), 0.005);
  EXPECT_GT(ambient.ambient_frac, 0.03);  // of the lit part's mean, which is below its peak
  EXPECT_LT(std::abs(ambient.shift_col_px), 0.05);
}

TEST(FrameChange, TurnedHeadShowsInItsPartsAlthoughTheWholeStays) {
  const FrameChange change = change_between({}, {.stripe_slope = 0.02, .seed = 2});
  print("turned", change);
  EXPECT_LT(std::abs(change.shift_col_px), 0.3);
  EXPECT_GT(change.local_shift_px, 0.4);  // 0.02 of up to 65 px to either side
  EXPECT_LT(change.local_shift_px, 1.0);
}

TEST(FrameChange, BlinkIsAPlaceAndMovesNothing) {
  const CameraInfo camera = striped_camera(392, 288);
  const FrameChange change = change_between({}, {.blink_frac = 0.5, .seed = 2}, camera);
  print("blink", change);
  ASSERT_EQ(change.local_changes.size(), 1U);
  const LocalChange& eye = change.local_changes.front();
  EXPECT_NEAR(eye.row_px, kEyeRowFrac * camera.height_px, 16);
  EXPECT_NEAR(eye.col_px, kEyeColFrac * camera.width_px, 24);
  EXPECT_LT(eye.height_frac, 0.5);
  EXPECT_GT(eye.change_frac, 5 * eye.sd_frac);
  EXPECT_LT(std::abs(change.shift_col_px), 0.02);
  EXPECT_LT(std::abs(change.light_frac), 0.003);
}

TEST(FrameChange, ClippedPixelsAreLeftOut) {
  CameraInfo camera = striped_camera();
  camera.saturation_level_dn = 900;
  const FrameChange change =
      change_between({}, {.shift_row_px = 0.3, .shift_col_px = 0.4, .seed = 2}, camera);
  print("clipped", change);
  EXPECT_NEAR(change.shift_col_px, 0.4, 0.1);
  EXPECT_LT(change.lit_frac, 0.3);
}

TEST(FrameChange, WhatCannotBeComparedIsSaidSo) {
  const CameraInfo camera = striped_camera();
  const Image<std::uint16_t> head = photograph({}, camera);
  const Image<std::uint16_t> dark(camera.height_px, camera.width_px, 1, 64);
  Image<std::uint16_t> other(camera.height_px, camera.width_px, 1);
  std::mt19937_64 random(3);
  for (auto& sample : other.samples()) sample = static_cast<std::uint16_t>(64 + random() % 2000);
  const auto of_dark = measure_change(camera, 12, dark.view(), head.view());
  ASSERT_FALSE(of_dark);
  EXPECT_THAT(of_dark.error().text(), HasSubstr("too little of the picture is lit"));
  const auto of_other = measure_change(camera, 12, head.view(), other.view());
  ASSERT_FALSE(of_other);
  EXPECT_THAT(of_other.error().text(), HasSubstr("do not show the same"));
  EXPECT_FALSE(measure_change(striped_camera(64, 48), 12, head.view(), head.view()));
}

TEST(FrameChange, ALitSpotTooSmallToTellItsUncertaintyIsNotCompared) {
  CameraInfo camera = striped_camera(2352, 1726);
  camera.pixel_format.filter = ColorFilter::kMono;
  Image<std::uint16_t> spot(camera.height_px, camera.width_px, 1, 64);
  for (int row = 420; row < 510; ++row)  // inside one block of 26 cells of 4 px
    for (int col = 420; col < 510; ++col)
      spot.at(row, col) = static_cast<std::uint16_t>(500 + 40 * ((row / 7 + col / 11) % 9));
  const auto change = measure_change(camera, 12, spot.view(), spot.view());
  ASSERT_FALSE(change);
  EXPECT_THAT(change.error().text(), HasSubstr("too little of the picture is lit"));
}

TEST(FrameChange, FramesOfAnySizeAndKindAreComparedOrRefused) {
  for (const auto& [width_px, height_px] :
       {std::pair(1, 1), std::pair(8, 8), std::pair(9, 9), std::pair(4096, 1), std::pair(4096, 6),
        std::pair(1, 900), std::pair(64, 48)}) {
    for (const ColorFilter filter :
         {ColorFilter::kMono, ColorFilter::kBayerRG, ColorFilter::kRgb}) {
      for (const int bit_depth : {8, 12, 16}) {
        SCOPED_TRACE(testing::Message() << width_px << " x " << height_px << ", " << bit_depth);
        CameraInfo camera;
        camera.width_px = width_px;
        camera.height_px = height_px;
        camera.pixel_format = {filter, bit_depth};
        Image<std::uint16_t> frame(height_px, width_px, sample_channel_count(filter));
        std::mt19937_64 random(3);
        for (auto& sample : frame.samples())
          sample = static_cast<std::uint16_t>(random() % (1U << (bit_depth - 1)));
        for (const double period_px : {0.0, 12.0, 1e12}) {
          const auto change = measure_change(camera, period_px, frame.view(), frame.view());
          if (change) {
            EXPECT_LT(change->shift_col_sd_px + change->ambient_sd_frac, 1);
          }
          const BlockGrid grid = block_grid(camera, Axis::kColumn, period_px);
          EXPECT_EQ(block_light(camera, grid, frame.view()).size(), grid.count());
        }
      }
    }
  }
}

}  // namespace
}  // namespace estimation
