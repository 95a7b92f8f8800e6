// Whole captures in the ledger world: every frame says in its pixels what it is, so a wrong
// assignment cannot hide.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <random>
#include <set>
#include <string>

#include "tests/capture/ledger_rig.h"

namespace capture {
namespace {

using hw_sim::SimFaults;
using std::chrono::milliseconds;

TEST(LedgerWorldCapture, FillsEverySlotWithItsOwnFrame) {
  LedgerCapture capture;
  const RunResult result = capture.run();
  EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
  EXPECT_EQ(capture.keeper.frames.size(), 176U);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
  EXPECT_EQ(result.retake_count, 0);
  EXPECT_TRUE(capture.incidents.empty());
}

TEST(LedgerWorldCapture, LeavesTheProjectorBlackAndTheDevicesDisarmed) {
  LedgerCapture capture;
  ASSERT_EQ(capture.run().outcome, Outcome::kComplete);
  capture.rig.timeline().wait(capture.rig.timeline().now() + milliseconds(50), {});
  EXPECT_EQ(hw_sim::shown_picture(capture.rig.picture_now()->id).picture, rig::kBlackPicture);
  EXPECT_TRUE(capture.rig.camera().arm({milliseconds(1)}, 1)) << "still armed";
  EXPECT_TRUE(capture.rig.trigger().arm({milliseconds(1)}, 1)) << "still armed";
}

TEST(LedgerWorldCapture, RunsTwiceOnTheSameDevices) {
  LedgerCapture capture;
  ASSERT_EQ(capture.run().outcome, Outcome::kComplete);
  capture.keeper.frames.clear();
  capture.keeper.frame_count = 0;
  ASSERT_EQ(capture.run().outcome, Outcome::kComplete);
  EXPECT_EQ(capture.keeper.frames.size(), 176U);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

TEST(LedgerWorldCapture, TriggerWidthAndACameraWithoutChunksWorkToo) {
  for (const auto bracketing : {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth}) {
    for (const bool has_chunks : {true, false}) {
      SCOPED_TRACE(std::to_string(static_cast<int>(bracketing)) + " chunks " +
                   std::to_string(has_chunks));
      rig::RigFile rig_file = ledger_rig_file();
      rig_file.camera.bracketing = bracketing;
      hw_sim::CameraTiming timing;
      timing.has_chunks = has_chunks;
      LedgerCapture capture({}, rig_file, timing);
      EXPECT_EQ(capture.run().outcome, Outcome::kComplete);
      EXPECT_EQ(capture.wrong_frame_count(), 0);
    }
  }
}

TEST(LedgerWorldCapture, SlowLinkSlowsThePaceInsteadOfLosingFrames) {
  hw_sim::CameraTiming timing;
  timing.transfer = std::chrono::microseconds(300'000);
  LedgerCapture capture({}, ledger_rig_file(), timing);
  const RunResult result = capture.run();
  EXPECT_EQ(result.outcome, Outcome::kComplete);
  EXPECT_EQ(result.retake_count, 0);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

// One fault each at the priming, the first pattern, a middle one and the last.
struct FaultCase {
  std::string name;
  std::function<void(SimFaults&, std::uint64_t)> plan;  // of the n-th frame, pulse, show ...
  bool is_per_pulse = true;                             // else once a pattern
  Incident incident = Incident::kFrameMissing;          // that must be noticed
};

std::vector<FaultCase> recoverable_faults() {
  return {
      {"frame dropped", [](SimFaults& f, auto n) { f.dropped_frames = {n}; }, true,
       Incident::kFrameMissing},
      {"frame damaged", [](SimFaults& f, auto n) { f.damaged_frames = {n}; }, true,
       Incident::kFrameDamaged},
      {"frame late",
       [](SimFaults& f, auto n) {
         f.late_frames = {n};
         f.frame_delay = milliseconds(1500);
       },
       true, Incident::kFrameMissing},
      {"edge missed", [](SimFaults& f, auto n) { f.missed_edges = {n}; }, false,
       Incident::kEdgeMissing},
      {"flash", [](SimFaults& f, auto n) { f.light_flashes = {n}; }, false,
       Incident::kEdgeDuringExposure},
      {"flip far too late",
       [](SimFaults& f, auto n) {
         f.late_flips = {n + 1};  // the black before the priming is a show, too
         f.flip_delay = milliseconds(700);
       },
       false, Incident::kEdgeMissing},
  };
}

class FaultAtAPlace : public testing::TestWithParam<rig::Bracketing> {};

TEST_P(FaultAtAPlace, IsNoticedRetakenAndNeverMisassigned) {
  for (const FaultCase& fault : recoverable_faults()) {
    for (const std::uint64_t pattern : {0U, 1U, 2U, 44U, 87U, 88U}) {  // 0 is the priming
      for (const std::uint64_t bracket : {0U, 1U}) {
        if (!fault.is_per_pulse && bracket > 0) continue;
        SCOPED_TRACE(fault.name + " at showing " + std::to_string(pattern) + " bracket " +
                     std::to_string(bracket));
        rig::RigFile rig_file = ledger_rig_file();
        rig_file.camera.bracketing = GetParam();
        SimFaults faults;
        fault.plan(faults, fault.is_per_pulse ? 2 * pattern + bracket + 1 : pattern + 1);
        LedgerCapture capture(faults, rig_file);
        const RunResult result = capture.run();
        EXPECT_EQ(result.outcome, Outcome::kComplete)
            << (result.failure ? result.failure->text : "");
        EXPECT_EQ(capture.keeper.frames.size(), 176U);
        EXPECT_EQ(capture.wrong_frame_count(), 0);
        EXPECT_GE(capture.incidents[fault.incident], 1);
        EXPECT_THAT(result.retake_count, testing::AllOf(testing::Ge(1), testing::Le(2)));
      }
    }
  }
}

TEST_P(FaultAtAPlace, PulseThatNeverReachesTheCameraIsNoticedAndNeverMisassigned) {
  for (const std::uint64_t pulse : {1U, 2U, 3U, 4U, 89U, 90U, 177U, 178U}) {
    for (const bool has_chunks : {true, false}) {
      SCOPED_TRACE("pulse " + std::to_string(pulse) + (has_chunks ? "" : ", no chunks"));
      rig::RigFile rig_file = ledger_rig_file();
      rig_file.camera.bracketing = GetParam();
      SimFaults faults;
      faults.dropped_pulses = {pulse};
      hw_sim::CameraTiming timing;
      timing.has_chunks = has_chunks;
      LedgerCapture capture(faults, rig_file, timing);
      const RunResult result = capture.run();
      EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
      EXPECT_EQ(capture.keeper.frames.size(), 176U);
      EXPECT_EQ(capture.wrong_frame_count(), 0);
      EXPECT_GE(result.retake_count, 1);
    }
  }
}

TEST_P(FaultAtAPlace, RepeatedLateAndHeldUpFramesCostNothing) {
  for (const std::uint64_t frame : {1U, 3U, 90U, 178U}) {
    SCOPED_TRACE(frame);
    rig::RigFile rig_file = ledger_rig_file();
    rig_file.camera.bracketing = GetParam();
    SimFaults faults;
    faults.repeated_frames = {frame};
    faults.late_frames = {frame + 1};  // overtaken by others
    faults.late_flips = {frame};
    LedgerCapture capture(faults, rig_file);
    const RunResult result = capture.run();
    EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
    EXPECT_EQ(capture.wrong_frame_count(), 0);
    EXPECT_EQ(result.retake_count, 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Bracketing, FaultAtAPlace,
                         testing::Values(rig::Bracketing::kSequencer,
                                         rig::Bracketing::kTriggerWidth));

TEST(LedgerWorldCapture, SequencerThatLostStepIsArmedAnew) {
  for (const std::uint64_t pulse : {1U, 2U, 3U, 4U, 90U, 177U, 178U}) {
    SCOPED_TRACE(pulse);
    SimFaults faults;
    faults.slips = {pulse};
    LedgerCapture capture(faults);
    const RunResult result = capture.run();
    EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
    EXPECT_EQ(capture.wrong_frame_count(), 0);
    EXPECT_GE(capture.incidents[Incident::kFrameMisexposed], 1);
    EXPECT_EQ(result.restart_count, 1);
  }
}

TEST(LedgerWorldCapture, RandomFaultsEndCompleteOrFailedButNeverWrong) {
  int complete_count = 0;
  constexpr int kCaptureCount = 300;
  for (int seed = 0; seed < kCaptureCount; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(static_cast<std::uint64_t>(seed));
    SimFaults faults;
    for (auto* numbers : {&faults.late_flips, &faults.missed_edges, &faults.light_flashes,
                          &faults.dropped_pulses, &faults.dropped_frames, &faults.damaged_frames,
                          &faults.repeated_frames, &faults.late_frames, &faults.slips})
      for (std::uint64_t k = random() % 4; k > 0; --k) numbers->insert(1 + random() % 190);
    faults.frame_delay = milliseconds(random() % 2000);
    rig::RigFile rig_file = ledger_rig_file();
    if (random() % 2 == 0) rig_file.camera.bracketing = rig::Bracketing::kTriggerWidth;
    LedgerCapture capture(faults, rig_file);
    const RunResult result = capture.run();
    ASSERT_EQ(capture.wrong_frame_count(), 0);
    ASSERT_NE(result.outcome, Outcome::kAborted);
    if (result.outcome == Outcome::kComplete) {
      ++complete_count;
      ASSERT_EQ(capture.keeper.frames.size(), 176U);
    } else {
      ASSERT_TRUE(result.failure);
    }
  }
  EXPECT_GT(complete_count, kCaptureCount * 9 / 10);
}

TEST(LedgerWorldCapture, PersistentFaultFailsWithSlotAndCauseNamed) {
  SimFaults faults;
  for (std::uint64_t edge = 20; edge < 200; ++edge) faults.light_flashes.insert(edge);
  LedgerCapture capture(faults);
  const RunResult result = capture.run();
  ASSERT_EQ(result.outcome, Outcome::kFailed);
  EXPECT_EQ(result.failure->incident, Incident::kEdgeDuringExposure);
  EXPECT_EQ(result.retake_count, 3);
  EXPECT_THAT(result.failure->slots, testing::ElementsAre(SlotId{18, 0}, SlotId{18, 1}));
  EXPECT_THAT(result.failure->text, testing::HasSubstr("pattern 18"));
  EXPECT_THAT(result.failure->text, testing::HasSubstr("shade the photodiode"));
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

TEST(LedgerWorldCapture, LostDeviceFailsCleanlyWhereverItHappens) {
  for (const std::uint64_t n : {1U, 2U, 45U, 89U}) {
    for (int device = 0; device < 3; ++device) {
      SCOPED_TRACE("device " + std::to_string(device) + " at " + std::to_string(n));
      SimFaults faults;
      if (device == 0) faults.projector_lost_at_show = n;
      if (device == 1) faults.trigger_lost_at_edge = n;
      if (device == 2) faults.camera_lost_at_pulse = n;
      LedgerCapture capture(faults);
      const RunResult result = capture.run();
      ASSERT_EQ(result.outcome, Outcome::kFailed);
      EXPECT_EQ(result.failure->incident, Incident::kDeviceLost);
      EXPECT_EQ(result.failure->device, static_cast<rig::Device>(device));
      EXPECT_THAT(result.failure->text, testing::HasSubstr("is gone"));
      EXPECT_EQ(capture.wrong_frame_count(), 0);
    }
  }
}

TEST(LedgerWorldCapture, AbortTurnsBlackWithinARefreshOfBeingHeard) {
  for (const int when : {1, 2, 3, 50, 300, 500}) {
    SCOPED_TRACE(when);
    LedgerCapture capture;
    std::stop_source stop;
    int transition_count = 0;
    rig::HostTime asked;
    const RunResult result = capture.run(stop.get_token(), [&](const Transition& transition) {
      if (++transition_count != when) return;
      asked = transition.time;
      stop.request_stop();
    });
    EXPECT_EQ(result.outcome, Outcome::kAborted);
    EXPECT_FALSE(result.failure);
    const auto black_after = capture.rig.timeline().now() - asked;
    EXPECT_LE(black_after, 3 * hw_sim::DisplayTiming{}.refresh_interval);
    EXPECT_EQ(capture.wrong_frame_count(), 0);
    EXPECT_TRUE(capture.rig.camera().arm({milliseconds(1)}, 1)) << "still armed";
  }
}

TEST(LedgerWorldCapture, FailureOfTheConsumerEndsTheCapture) {
  LedgerCapture capture;
  int transition_count = 0;
  const RunResult result = capture.run({}, [&](const Transition&) {
    if (++transition_count == 200) capture.keeper.injected_failure = "the disk is full";
  });
  ASSERT_EQ(result.outcome, Outcome::kFailed);
  EXPECT_EQ(result.failure->incident, Incident::kStorage);
  EXPECT_EQ(result.failure->text, "the disk is full");
  EXPECT_LT(capture.keeper.frames.size(), 176U);
}

}  // namespace
}  // namespace capture
