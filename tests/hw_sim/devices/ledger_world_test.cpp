#include "hw_sim/devices/ledger_world.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

namespace hw_sim {
namespace {

using estimation::Image;
using std::chrono::microseconds;

std::shared_ptr<const Picture> picture(std::uint64_t id, unsigned char grey) {
  return std::make_shared<const Picture>(Picture{id, Image<unsigned char>(48, 64, 1, grey)});
}

Image<std::uint16_t> expose(const Exposure& exposure) {
  Image<std::uint16_t> frame(LedgerWorld::kHeightPx, LedgerWorld::kWidthPx);
  LedgerWorld().expose(exposure, frame.view());
  return frame;
}

TEST(LedgerWorld, FrameSaysWhatMadeIt) {
  const auto first = picture(3, 10);
  const auto second = picture(4, 20);
  const auto frame = expose({.light = {{first, microseconds(4000)}, {second, microseconds(6000)}},
                             .duration = microseconds(10'000),
                             .trigger_number = 17});
  const auto identity = decode_identity(frame.view());
  ASSERT_TRUE(identity);
  EXPECT_EQ(identity->trigger_number, 17U);
  EXPECT_EQ(identity->exposure, microseconds(10'000));
  EXPECT_THAT(identity->light,
              testing::ElementsAre(
                  FrameIdentity::Light{3, content_hash(first->brightness), microseconds(4000)},
                  FrameIdentity::Light{4, content_hash(second->brightness), microseconds(6000)}));
}

TEST(LedgerWorld, PicturesOfOtherContentHaveOtherHashes) {
  EXPECT_NE(content_hash(picture(1, 10)->brightness), content_hash(picture(1, 11)->brightness));
}

TEST(LedgerWorld, AnyChangedSampleIsNoticed) {
  const auto frame = expose({.light = {{picture(3, 10), microseconds(4000)}},
                             .duration = microseconds(4000),
                             .trigger_number = 1});
  for (std::size_t sample = 0; sample < frame.samples().size(); sample += 7) {
    Image<std::uint16_t> damaged = frame;
    damaged.samples()[sample] ^= 1;
    ASSERT_FALSE(decode_identity(damaged.view())) << "sample " << sample;
  }
}

}  // namespace
}  // namespace hw_sim
