// Block ids unwrapped: 16 bit ids skip 0, 64 bit ids never wrap, stale ids are none.
#include "rig/devices/block_id.h"

#include <gtest/gtest.h>

namespace {

using rig::BlockIdCounter;

TEST(BlockIdCounter, CountsFromOneAndShowsGaps) {
  BlockIdCounter ids(176);
  EXPECT_EQ(ids.advance(1), 1U);
  EXPECT_EQ(ids.advance(2), 2U);
  EXPECT_EQ(ids.advance(5), 5U);
  EXPECT_EQ(ids.latest(), 5U);
}

TEST(BlockIdCounter, SixteenBitIdsWrapPastZero) {
  BlockIdCounter ids(176);
  std::uint64_t expected = 0;
  for (int round = 0; round < 2; ++round)
    for (std::uint64_t wire_id = 1; wire_id <= 0xFFFF; ++wire_id)
      ASSERT_EQ(ids.advance(wire_id), ++expected);
}

TEST(BlockIdCounter, GapAcrossTheWrapIsCounted) {
  BlockIdCounter ids(70'000);
  EXPECT_EQ(ids.advance(65'534), 65'534U);
  EXPECT_EQ(ids.advance(2), 65'537U);  // 65535 and 1 are missing
}

TEST(BlockIdCounter, SixtyFourBitIdsGoOn) {
  BlockIdCounter ids(70'000);
  EXPECT_EQ(ids.advance(65'535), 65'535U);
  EXPECT_EQ(ids.advance(65'536), 65'536U);
  EXPECT_EQ(ids.advance(65'537), 65'537U);
}

TEST(BlockIdCounter, StaleAndZeroIdsAreNone) {
  BlockIdCounter ids(176);
  EXPECT_FALSE(ids.advance(0).has_value());
  EXPECT_EQ(ids.advance(10), 10U);
  EXPECT_FALSE(ids.advance(10).has_value());
  EXPECT_FALSE(ids.advance(9).has_value());
  EXPECT_FALSE(ids.advance(0).has_value());
  EXPECT_EQ(ids.advance(11), 11U);
}

TEST(BlockIdCounter, CameraThatNeverRestartsItsIdsStartsAtOneAllTheSame) {
  BlockIdCounter ids(176);
  EXPECT_EQ(ids.advance(65'401), 1U);
  EXPECT_EQ(ids.advance(65'402), 2U);
}

TEST(BlockIdCounter, FirstFramesLostAreAGap) {
  BlockIdCounter ids(176);
  EXPECT_EQ(ids.advance(3), 3U);
}

}  // namespace
