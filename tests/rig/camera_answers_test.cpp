#include "rig/devices/camera_answers.h"

#include <gtest/gtest.h>

#include <limits>

namespace {

using rig::ChunkAnswers;

rig::Result<void> taken(const ChunkAnswers& answers, std::int64_t trigger_base = 0) {
  rig::Frame frame;
  return rig::take_chunks(answers, {.trigger_base = trigger_base}, frame);
}

TEST(CameraAnswers, ChunksCountFromTheArming) {
  rig::Frame frame;
  const ChunkAnswers answers{
      .exposure_us = 999.6, .trigger_count = 12, .sequencer_set = 1, .line_status = 0b101};
  ASSERT_TRUE(rig::take_chunks(answers, {.trigger_base = 10, .line_bit = 1}, frame));
  EXPECT_EQ(frame.exposure, std::chrono::microseconds(1000));
  EXPECT_EQ(frame.trigger_count, 2U);
  EXPECT_EQ(frame.sequencer_set, 1);
  EXPECT_EQ(frame.is_line_high, false) << "the lines beside it are high";
}

TEST(CameraAnswers, AnExposureThatNoneCanBeIsMalformed) {
  for (const double exposure_us : {-1.0, 1e9, std::numeric_limits<double>::infinity(),
                                   std::numeric_limits<double>::quiet_NaN()}) {
    SCOPED_TRACE(exposure_us);
    ChunkAnswers answers;
    answers.exposure_us = exposure_us;
    const auto result = taken(answers);
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().fault, rig::Fault::kFrameMalformed);
  }
}

TEST(CameraAnswers, ACounterThatRanBackwardsIsMalformed) {
  ChunkAnswers answers;
  answers.trigger_count = 9;
  EXPECT_FALSE(taken(answers, 10));
  answers.trigger_count = std::numeric_limits<std::int64_t>::max();
  EXPECT_FALSE(taken(answers, std::numeric_limits<std::int64_t>::min()));
  EXPECT_EQ(rig::counted_since(10, 9), -1);
  EXPECT_EQ(rig::counted_since(10, 12), 2);
}

TEST(CameraAnswers, ASetBeyondAnIntIsMalformed) {
  ChunkAnswers answers;
  answers.sequencer_set = std::int64_t{1} << 40;
  EXPECT_FALSE(taken(answers));
  answers.sequencer_set = -1;
  EXPECT_FALSE(taken(answers));
}

TEST(CameraAnswers, BuffersHoldTheImageThatIsReadFromThem) {
  EXPECT_TRUE(rig::check_payload(1000, 1000));
  EXPECT_TRUE(rig::check_payload(1064, 1000)) << "with chunks";
  EXPECT_FALSE(rig::check_payload(999, 1000));
  EXPECT_FALSE(rig::check_payload(std::size_t{4} << 30, 1000));
}

}  // namespace
