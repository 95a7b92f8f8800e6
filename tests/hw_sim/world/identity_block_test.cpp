// The proof of which trigger and which light made which frame.
#include "hw_sim/world/identity_block.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/hw_sim/world/phantom_shots.h"

namespace hw_sim {
namespace {

using estimation::Axis;
using estimation::Image;
using estimation::Stripes;

constexpr IdentityBlockLayout kLayout{64, 4095};
const IdentityBlock kIdentity{.trigger_number = 4'000'000'123U,
                              .exposure = microseconds(66667),
                              .picture_id = 0x1234'5678'9ABC'DEF0U,
                              .picture_hash = 0xC0FFEE42U,
                              .share_of_255 = 200,
                              .picture_count = 2};

TEST(IdentityBlock, ComesBackForEveryDepthAndChannelCount) {
  for (const int adc_max_dn : {255, 4095, 65535})
    for (const int channels : {1, 3}) {
      const IdentityBlockLayout layout{4, adc_max_dn};
      Image<std::uint16_t> frame(40, 50, channels, 1000);
      layout.write(kIdentity, frame.view());
      EXPECT_EQ(layout.read(std::as_const(frame).view()), kIdentity);
      // Nothing beside it is touched.
      EXPECT_EQ(frame.at(0, IdentityBlockLayout::kWidthPx), 1000);
      EXPECT_EQ(frame.at(IdentityBlockLayout::kHeightPx, 0), 1000);
    }
}

TEST(IdentityBlock, NoiseLeavesItAndDamageIsNoticed) {
  Image<std::uint16_t> frame(40, 50);
  kLayout.write(kIdentity, frame.view());
  const int quarter = (kLayout.set_dn() - 64) / 4;
  std::mt19937_64 random(5);
  Image<std::uint16_t> noisy = frame;
  for (auto& sample : noisy.samples())
    sample = static_cast<std::uint16_t>(
        sample + static_cast<int>(random() % (2U * static_cast<unsigned>(quarter) + 1U)) - quarter);
  EXPECT_EQ(kLayout.read(std::as_const(noisy).view()), kIdentity);
  for (int row = 0; row < IdentityBlockLayout::kHeightPx; ++row)
    for (int col = 0; col < IdentityBlockLayout::kWidthPx; ++col) {
      Image<std::uint16_t> damaged = frame;
      damaged.at(row, col) = damaged.at(row, col) == 64 ? 300 : 64;
      EXPECT_FALSE(kLayout.read(std::as_const(damaged).view())) << row << " " << col;
    }
  EXPECT_FALSE(kLayout.read(std::as_const(*std::make_unique<Image<std::uint16_t>>(40, 50)).view()));
  EXPECT_FALSE(kLayout.read(std::as_const(*std::make_unique<Image<std::uint16_t>>(20, 4)).view()));
}

TEST(IdentityBlock, EveryFrameOfTheDevicesSaysWhatMadeIt) {
  const TestRig rig = make_test_rig(49, 36, 4);  // with the sensor's noise
  const auto world = make_world(rig, quick_scene("flat_phantom"));
  RigShots shots(rig, *world);
  std::vector<estimation::PatternKind> patterns;
  for (const int shift : {3, 17, 31}) patterns.emplace_back(Stripes{Axis::kColumn, 40, 8, shift});
  const std::vector<microseconds> exposures = {microseconds(5000), microseconds(20000)};
  const auto taken = shots.take(patterns, exposures);
  ASSERT_EQ(taken.size(), 6U);
  for (std::size_t i = 0; i < taken.size(); ++i) {
    const auto identity = kLayout.read(std::as_const(taken[i].dn).view());
    ASSERT_TRUE(identity) << i;
    EXPECT_EQ(identity->trigger_number, i + 1);
    EXPECT_EQ(identity->trigger_number, taken[i].trigger_number);
    EXPECT_EQ(identity->exposure, exposures[i % 2]);
    EXPECT_EQ(identity->picture_count, 1);
    EXPECT_EQ(identity->share_of_255, 255);
    EXPECT_EQ(shown_picture(identity->picture_id).picture, static_cast<int>(i / 2));
    // The picture is the pattern, its sync square in the corner.
    Image<unsigned char> shown = make_picture(rig, patterns[i / 2]).brightness;
    const bool is_light = shown_picture(identity->picture_id).is_square_light;
    for (int row = shown.height_px() - 8; row < shown.height_px(); ++row)
      for (int col = shown.width_px() - 8; col < shown.width_px(); ++col)
        shown.at(row, col) = is_light ? 255 : 0;
    EXPECT_EQ(identity->picture_hash, picture_hash(shown)) << i;
  }
}

// The shutter opens with the first picture and stays open over the flip to the second.
TEST(IdentityBlock, AnExposureThatStraddlesAFlipShowsBothAndSaysSo) {
  TestRig rig = quiet_rig();
  const auto world = make_world(rig, quick_scene("flat_phantom"));
  RigShots shots(rig, *world);
  const Stripes first{Axis::kColumn, 40, 20, 0}, second{Axis::kRow, 40, 20, 0};
  const Shot both = shots.take_straddling(first, second, microseconds(30000));
  const auto identity = kLayout.read(std::as_const(both.dn).view());
  ASSERT_TRUE(identity);
  EXPECT_EQ(identity->picture_count, 2);
  EXPECT_EQ(shown_picture(identity->picture_id).picture, 0);
  EXPECT_NEAR(identity->share_of_255, 255 * 16.667 / 30, 1);
  const Image<float> a = world->linear_image(make_picture(rig, first, 101));
  const Image<float> b = world->linear_image(make_picture(rig, second, 102));
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col)
      EXPECT_NEAR(both.at(row, col) - kBlackDn,
                  16666.667 * static_cast<double>(a.at(row, col)) +
                      13333.333 * static_cast<double>(b.at(row, col)),
                  1.5);
}

}  // namespace
}  // namespace hw_sim
