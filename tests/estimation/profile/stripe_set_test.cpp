// Choosing the stripes to fit, and the optics' contrast for their harmonics.
#include "estimation/profile/stripe_set.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <string>

#include "estimation/profile/stripe_transfer.h"

namespace estimation {
namespace {

std::optional<StripeSet> choose(const std::vector<PatternKind>& kinds) {
  std::vector<const PatternKind*> pointers;
  pointers.reserve(kinds.size());
  for (const PatternKind& kind : kinds) pointers.push_back(&kind);
  return choose_stripe_set(pointers);
}

void add(std::vector<PatternKind>& kinds, Axis axis, int period_px, int width_px, int step_px) {
  for (int shift = 0; shift < period_px; shift += step_px)
    kinds.emplace_back(Stripes{axis, period_px, width_px, shift});
}

TEST(StripeSet, FineSetsServeCorrespondenceOnly) {
  std::vector<PatternKind> kinds{White{}, GrayCode{}};
  add(kinds, Axis::kColumn, 16, 8, 4);
  EXPECT_FALSE(choose(kinds));
  add(kinds, Axis::kRow, 16, 8, 1);
  add(kinds, Axis::kRow, 40, 8, 4);
  const auto set = choose(kinds);
  ASSERT_TRUE(set);
  EXPECT_EQ(set->axis, Axis::kRow);
  EXPECT_EQ(set->shape.period_px, 40);
  EXPECT_EQ(set->shifts_px.size(), 10U);
}

TEST(StripeSet, ShiftsAreSortedReducedAndRepeatsShareOne) {
  std::vector<PatternKind> kinds;
  add(kinds, Axis::kColumn, 40, 8, 5);
  kinds.emplace_back(Stripes{Axis::kColumn, 40, 8, -37});  // that is shift 3
  kinds.emplace_back(Stripes{Axis::kColumn, 40, 8, 45});   // that is shift 5
  const auto set = choose(kinds);
  ASSERT_TRUE(set);
  EXPECT_EQ(set->shifts_px, (std::vector<int>{0, 3, 5, 10, 15, 20, 25, 30, 35}));
  EXPECT_EQ(set->sources[1], (std::vector<std::size_t>{8}));
  EXPECT_EQ(set->sources[2], (std::vector<std::size_t>{1, 9}));
}

CameraInfo camera(ColorFilter filter) {
  CameraInfo info;
  info.width_px = 2;
  info.height_px = 1;
  info.pixel_format = {.filter = filter, .bit_depth = 8};
  return info;
}

std::vector<float> contrast(const HarmonicTransfer& transfer, int band, double distance_mm,
                            int period_px, std::size_t count, int col = 0) {
  std::vector<float> out(count);
  transfer.at(0, col, band, distance_mm, period_px, out);
  return out;
}

TEST(HarmonicTransfer, AbsentMeansPerfect) {
  const auto transfer = HarmonicTransfer::create(std::nullopt, {}, camera(ColorFilter::kRgb));
  ASSERT_TRUE(transfer);
  EXPECT_TRUE(transfer->is_perfect());
  EXPECT_EQ(contrast(*transfer, 2, 1000, 40, 3), (std::vector<float>{1, 1, 1}));
}

TEST(HarmonicTransfer, InterpolatesBetweenHarmonicsAndContinuesAsAGaussian) {
  TransferByBand by_band;
  by_band.harmonics = {{{0.9, 0.6}, {0.8, 0.5}, {0.7, 0.4}}};
  const auto transfer = HarmonicTransfer::create(by_band, {}, camera(ColorFilter::kRgb));
  ASSERT_TRUE(transfer);
  EXPECT_FALSE(transfer->is_perfect());
  const auto same_period = contrast(*transfer, 1, 0, 40, 4);
  EXPECT_FLOAT_EQ(same_period[0], 0.8F);
  EXPECT_FLOAT_EQ(same_period[1], 0.5F);
  EXPECT_FLOAT_EQ(same_period[3], 0.0625F);  // 0.5 ^ (4/2)^2
  const auto double_period = contrast(*transfer, 1, 0, 80, 3);
  EXPECT_FLOAT_EQ(double_period[1], 0.8F);
  // Half a cycle is between 1 and 0.8, and higher than the middle: the curve begins level.
  EXPECT_GT(double_period[0], 0.9F);
  EXPECT_LT(double_period[0], 1.0F);
  EXPECT_NEAR(double_period[2], 0.65F, 0.02F);
}

TEST(HarmonicTransfer, IsABlursAtAnyPeriod) {
  const auto of_blur = [](double cycles_per_40_px) {  // of 1 px
    return std::exp(-0.5 * std::pow(2 * std::numbers::pi * cycles_per_40_px / 40, 2));
  };
  TransferByBand by_band;
  for (int n = 1; n <= 12; ++n) by_band.harmonics[0].push_back(of_blur(n));
  const auto transfer = HarmonicTransfer::create(by_band, {}, camera(ColorFilter::kMono));
  ASSERT_TRUE(transfer);
  for (const int period_px : {16, 24, 50, 64, 100}) {
    const auto found = contrast(*transfer, 0, 0, period_px, 8);
    for (int n = 1; n <= 8; ++n) {
      SCOPED_TRACE(std::to_string(n) + " of " + std::to_string(period_px));
      EXPECT_NEAR(found[static_cast<std::size_t>(n) - 1], of_blur(40.0 * n / period_px), 3e-4);
    }
  }
}

TEST(HarmonicTransfer, NoiseAboveOneAtTheEndDoesNotGrow) {
  TransferByBand by_band;
  by_band.harmonics[0] = {0.99, 1.02};
  const auto transfer = HarmonicTransfer::create(by_band, {}, camera(ColorFilter::kMono));
  ASSERT_TRUE(transfer);
  EXPECT_FLOAT_EQ(contrast(*transfer, 0, 0, 40, 20)[19], 1.0F);  // 1.02 ^ (20/2)^2 is 7
}

TEST(HarmonicTransfer, InterpolatesInDepthAndHoldsTheEnds) {
  TransferByDepth by_depth;
  for (const double m : {0.8, 0.4}) {
    TransferByBand entry;
    entry.harmonics[0] = {m};
    by_depth.entries.push_back({.distance_mm = m == 0.8 ? 900.0 : 1100.0, .transfer = entry});
  }
  const auto transfer = HarmonicTransfer::create(by_depth, {}, camera(ColorFilter::kMono));
  ASSERT_TRUE(transfer);
  EXPECT_FLOAT_EQ(contrast(*transfer, 0, 950, 40, 1)[0], 0.7F);
  EXPECT_FLOAT_EQ(contrast(*transfer, 0, 100, 40, 1)[0], 0.8F);
  EXPECT_FLOAT_EQ(contrast(*transfer, 0, 5000, 40, 1)[0], 0.4F);
}

TEST(HarmonicTransfer, ReadsMapsFromAFileAndRefusesOthers) {
  std::map<std::string, Image<float>> file;
  for (const char* name : {"R.1", "G.1", "B.1"}) file[name] = Image<float>(1, 2, 1, 0.5F);
  file["B.2"] = Image<float>(1, 2, 1, 0.25F);
  file["G.1"].at(0, 1) = 0.75F;
  const StripeTransfer calibration = TransferFile{"transfer.exr"};
  const auto transfer = HarmonicTransfer::create(calibration, file, camera(ColorFilter::kBayerRG));
  ASSERT_TRUE(transfer);
  EXPECT_FLOAT_EQ(contrast(*transfer, 1, 0, 40, 1, 1)[0], 0.75F);
  EXPECT_FLOAT_EQ(contrast(*transfer, 2, 0, 40, 2)[1], 0.25F);
  file.erase("G.1");
  EXPECT_FALSE(HarmonicTransfer::create(calibration, file, camera(ColorFilter::kBayerRG)));
  file["G.1"] = Image<float>(3, 3, 1, 0.5F);
  EXPECT_FALSE(HarmonicTransfer::create(calibration, file, camera(ColorFilter::kBayerRG)));
  file["G.1"] = Image<float>(1, 2, 1, 1.2F);
  EXPECT_FALSE(HarmonicTransfer::create(calibration, file, camera(ColorFilter::kBayerRG)));
}

}  // namespace
}  // namespace estimation
