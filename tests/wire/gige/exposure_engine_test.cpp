// Which pulses become exposures, for how long.
#include "hw_sim/exposure_engine.h"

#include <gtest/gtest.h>

namespace {

using hw_sim::ExposureEngine;
using std::chrono::microseconds;

constexpr rig::HostTime kStart{std::chrono::seconds(5)};

ExposureEngine two_set_sequencer() {
  ExposureEngine engine;
  engine.is_sequencer_on = true;
  engine.sets[0] = {microseconds(1000), 1};
  engine.sets[1] = {microseconds(4000), 0};
  engine.readout = microseconds(500);
  engine.start();
  return engine;
}

TEST(ExposureEngine, SequencerStepsOncePerExposure) {
  ExposureEngine engine = two_set_sequencer();
  for (int i = 0; i < 6; ++i) {
    const auto job = engine.trigger(kStart + i * microseconds(10'000), microseconds(77));
    ASSERT_TRUE(job.has_value());
    EXPECT_EQ(job->sequencer_set, i % 2);
    EXPECT_EQ(job->duration, microseconds(i % 2 == 0 ? 1000 : 4000));
    EXPECT_EQ(job->trigger_number, static_cast<std::uint64_t>(i + 1));
  }
}

TEST(ExposureEngine, PulseUntilTheEndOfReadoutIsMissedAndMovesNoSequencer) {
  ExposureEngine engine = two_set_sequencer();
  ASSERT_TRUE(engine.trigger(kStart, microseconds(0)).has_value());
  EXPECT_FALSE(engine.trigger(kStart + microseconds(1499), microseconds(0)).has_value());
  EXPECT_EQ(engine.missed_count(), 1U);
  EXPECT_EQ(engine.active_set(), 1);
  const auto next = engine.trigger(kStart + microseconds(1500), microseconds(0));
  ASSERT_TRUE(next.has_value());
  EXPECT_EQ(next->sequencer_set, 1);
  EXPECT_EQ(next->trigger_number, 3U);
}

TEST(ExposureEngine, WidthDecidesUnderTriggerWidth) {
  ExposureEngine engine;
  engine.bracketing = rig::Bracketing::kTriggerWidth;
  engine.start();
  const auto job = engine.trigger(kStart, microseconds(1234));
  ASSERT_TRUE(job.has_value());
  EXPECT_EQ(job->duration, microseconds(1234));
  EXPECT_EQ(job->sequencer_set, -1);
}

TEST(ExposureEngine, FixedExposureOtherwise) {
  ExposureEngine engine;
  engine.fixed_exposure = microseconds(2222);
  engine.start();
  const auto job = engine.trigger(kStart, microseconds(1234));
  ASSERT_TRUE(job.has_value());
  EXPECT_EQ(job->duration, microseconds(2222));
}

TEST(ExposureEngine, StartAgainForgetsCountsSetAndBusiness) {
  ExposureEngine engine = two_set_sequencer();
  engine.start_set = 0;
  ASSERT_TRUE(engine.trigger(kStart, microseconds(0)).has_value());
  ASSERT_FALSE(engine.trigger(kStart, microseconds(0)).has_value());
  engine.start();
  EXPECT_EQ(engine.trigger_count(), 0U);
  EXPECT_EQ(engine.missed_count(), 0U);
  const auto job = engine.trigger(kStart, microseconds(0));
  ASSERT_TRUE(job.has_value());
  EXPECT_EQ(job->sequencer_set, 0);
  EXPECT_EQ(job->trigger_number, 1U);
}

TEST(ExposureEngine, SlipLeavesTheSequencerOutOfStep) {
  ExposureEngine engine = two_set_sequencer();
  engine.slip();
  EXPECT_EQ(engine.trigger(kStart, microseconds(0))->sequencer_set, 1);
}

}  // namespace
