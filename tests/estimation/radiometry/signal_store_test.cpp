#include "estimation/radiometry/signal_store.h"

#include <gtest/gtest.h>

namespace estimation {
namespace {

constexpr int kWidthPx = 4, kHeightPx = 3;
constexpr double kSaturationDn = 4000, kBlackDn = 64;

Pattern pattern(int index, PatternKind kind) {
  Pattern made;
  made.index = index;
  made.kind = kind;
  return made;
}

// Gray code of bit 3 with its inverse, of bit 4 alone, a stripe and black; two exposures of each.
Manifest manifest_of(ColorFilter filter) {
  Manifest manifest;
  manifest.camera.width_px = kWidthPx;
  manifest.camera.height_px = kHeightPx;
  manifest.camera.pixel_format = {filter, 12};
  manifest.patterns = {pattern(0, GrayCode{.bit = 3}),
                       pattern(1, GrayCode{.bit = 3, .inverted = true}),
                       pattern(2, GrayCode{.bit = 4}), pattern(3, Stripes{}), pattern(4, Black{})};
  for (int index = 0; index < 5; ++index)
    for (const double exposure_us : {100.0, 400.0}) {
      FrameRecord frame;
      frame.pattern = index;
      frame.exposure_us = exposure_us;
      frame.file = std::to_string(index) + "_" + std::to_string(exposure_us);
      manifest.frames.push_back(frame);
    }
  return manifest;
}

SignalStore::Signals taken(const Manifest& manifest, CodeFrames code_frames,
                           Image<float> flat_field = {}, std::optional<std::size_t> without = {}) {
  SignalStore store(manifest, CameraBlack(kBlackDn), kSaturationDn, std::move(flat_field),
                    code_frames);
  const int channels = sample_channel_count(manifest.camera.pixel_format.filter);
  for (std::size_t i = 0; i < manifest.frames.size(); ++i) {
    if (i == without) continue;
    const auto dn = static_cast<std::uint16_t>(100 + 10 * i);
    const Image<std::uint16_t> frame(kHeightPx, kWidthPx, channels, dn);
    EXPECT_TRUE(store.add(i, frame.view()));
  }
  return store.take();
}

bool is_left(const PatternRate& pattern) { return pattern.rate.empty() && !pattern.frames.empty(); }
bool is_merged(const PatternRate& pattern) {
  return !pattern.rate.empty() && pattern.frames.empty();
}

TEST(SignalStore, CodeInPairsIsLeftAsFramesIfAsked) {
  const Manifest manifest = manifest_of(ColorFilter::kMono);
  const SignalStore::Signals signals = taken(manifest, CodeFrames::kLeft);
  ASSERT_EQ(signals.patterns.size(), 4U);  // black is subtracted
  EXPECT_TRUE(is_left(signals.patterns[0]));
  EXPECT_TRUE(is_left(signals.patterns[1]));
  EXPECT_TRUE(is_merged(signals.patterns[2]));
  EXPECT_TRUE(is_merged(signals.patterns[3]));
  EXPECT_EQ(signals.patterns[1].exposures_us, (std::vector<double>{100, 400}));
  EXPECT_EQ(signals.patterns[1].frames[1].at(0, 0), 130);
  for (const PatternRate& all : taken(manifest, CodeFrames::kMerged).patterns)
    EXPECT_TRUE(is_merged(all));
}

TEST(SignalStore, WhatBlackAndFlatFieldMatterToIsMerged) {
  const Image<float> flat(kHeightPx, kWidthPx, 1, 1.0F);
  const Manifest mono = manifest_of(ColorFilter::kMono);
  for (const PatternRate& all : taken(mono, CodeFrames::kLeft, flat).patterns)
    EXPECT_TRUE(is_merged(all));
  const Manifest rgb = manifest_of(ColorFilter::kRgb);
  for (const PatternRate& all : taken(rgb, CodeFrames::kLeft).patterns) EXPECT_TRUE(is_merged(all));
}

TEST(SignalStore, APairThatIsNotWholeIsMergedOrLeftByWhatCame) {
  Manifest manifest = manifest_of(ColorFilter::kMono);
  // One exposure is missing: the other is left.
  const SignalStore::Signals some = taken(manifest, CodeFrames::kLeft, {}, 3);
  EXPECT_TRUE(is_left(some.patterns[1]));
  EXPECT_EQ(some.patterns[1].frames.size(), 1U);
  EXPECT_EQ(some.notes.size(), 1U);
  // No frame of the inverse came: black has to be subtracted.
  manifest.frames.erase(manifest.frames.begin() + 2, manifest.frames.begin() + 4);
  const SignalStore::Signals alone = taken(manifest, CodeFrames::kLeft);
  EXPECT_TRUE(is_merged(alone.patterns[0]));
}

}  // namespace
}  // namespace estimation
