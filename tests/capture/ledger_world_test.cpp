// Whole captures in the ledger world: every frame says in its pixels what it is, so a wrong
// assignment cannot hide.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "tests/capture/ledger_rig.h"

namespace capture {
namespace {

using hw_sim::FaultKind;
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

void expect_faultless(const rig::RigFile& rig_file) {
  LedgerCapture capture({}, rig_file);
  const RunResult result = capture.run();
  EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
  EXPECT_EQ(capture.keeper.frames.size(), 176U);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
  EXPECT_EQ(result.retake_count, 0);
  EXPECT_TRUE(capture.incidents.empty());
}

TEST(LedgerWorldCapture, PhotodiodeOnTheCamerasLineNeedsNoBox) {
  expect_faultless(boxless_rig_file(rig::SyncMode::kCameraLine));
}

TEST(LedgerWorldCapture, SoftwareTriggerNeedsNoPhotodiode) {
  expect_faultless(boxless_rig_file(rig::SyncMode::kSoftware));
}

TEST(LedgerWorldCapture, PacedWaitsForNothing) {
  for (const auto sync : {rig::SyncMode::kTriggerBox, rig::SyncMode::kCameraLine}) {
    SCOPED_TRACE(static_cast<int>(sync));
    rig::RigFile rig_file =
        sync == rig::SyncMode::kTriggerBox ? ledger_rig_file() : boxless_rig_file(sync);
    rig_file.sequence.pace = rig::Pace::kPaced;
    expect_faultless(rig_file);
  }
}

// A projector that scans: a picture's first row is lit a refresh before its square is.
class ScanningWorld final : public hw_sim::World {
 public:
  int width_px() const override { return ledger_.width_px(); }
  int height_px() const override { return ledger_.height_px(); }
  int channel_count() const override { return 1; }
  hw_sim::LampTiming lamp_timing() const override {
    return {.input_lag_refreshes = 1, .scanout = hw_sim::DisplayTiming{}.refresh_interval};
  }
  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    ledger_.expose(exposure, frame_dn);
  }

 private:
  hw_sim::LedgerWorld ledger_;
};

// Until the shutter closes, not even the first row is the next picture's.
TEST(LedgerWorldCapture, NoPaceLetsTheNextPictureIntoAFrame) {
  for (const auto sync : {rig::SyncMode::kTriggerBox, rig::SyncMode::kCameraLine}) {
    for (const auto pace : {rig::Pace::kHandshake, rig::Pace::kPaced}) {
      SCOPED_TRACE(std::to_string(static_cast<int>(sync)) + " " +
                   std::to_string(static_cast<int>(pace)));
      rig::RigFile rig_file =
          sync == rig::SyncMode::kTriggerBox ? ledger_rig_file() : boxless_rig_file(sync);
      rig_file.sequence.pace = pace;
      const ScanningWorld world;
      hw_sim::InProcessRig rig(
          world, {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}, sync});
      const Plan plan = ledger_plan(rig_file);
      IdentityKeeper keeper;
      const RunResult result = run_capture(
          {rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, plan, rig_file.projector,
          make_rules(rig_file, plan.exposures, 60), keeper, {}, [](const Transition&) {});
      EXPECT_EQ(result.outcome, Outcome::kComplete);
      ASSERT_EQ(keeper.frames.size(), 176U);
      for (const auto& kept : keeper.frames)
        EXPECT_EQ(hw_sim::shown_picture(kept.identity.light.back().picture_id).picture,
                  kept.captured.slot.pattern);
    }
  }
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

TEST(LedgerWorldCapture, ACameraWithoutChunksNeedsTriggerWidth) {
  for (const auto bracketing : {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth}) {
    for (const bool has_chunks : {true, false}) {
      SCOPED_TRACE(std::to_string(static_cast<int>(bracketing)) + " chunks " +
                   std::to_string(has_chunks));
      rig::RigFile rig_file = ledger_rig_file();
      rig_file.camera.bracketing = bracketing;
      hw_sim::CameraTiming timing;
      timing.has_chunks = has_chunks;
      LedgerCapture capture({}, rig_file, timing);
      const RunResult result = capture.run();
      EXPECT_EQ(capture.wrong_frame_count(), 0);
      // Without the exposure in the frame nothing would show a sequencer out of step.
      if (bracketing == rig::Bracketing::kTriggerWidth || has_chunks) {
        EXPECT_EQ(result.outcome, Outcome::kComplete);
      } else {
        ASSERT_EQ(result.outcome, Outcome::kFailed);
        EXPECT_THAT(result.failure->text, testing::HasSubstr("trigger_width"));
      }
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

TEST(LedgerWorldCapture, PersistentFaultFailsWithSlotAndCauseNamed) {
  LedgerCapture capture({.faults = {fault_at(FaultKind::kLightFlash, 19, 0, 200)}});
  const RunResult result = capture.run();
  ASSERT_EQ(result.outcome, Outcome::kFailed);
  EXPECT_EQ(result.failure->incident, Incident::kEdgeDuringExposure);
  EXPECT_EQ(result.retake_count, 3);
  EXPECT_THAT(result.failure->slots, testing::ElementsAre(SlotId{18, 0}, SlotId{18, 1}));
  EXPECT_THAT(result.failure->text, testing::HasSubstr("pattern 18"));
  EXPECT_THAT(result.failure->text, testing::HasSubstr("shade the photodiode"));
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

TEST(LedgerWorldCapture, DeviceThatStaysLostFailsCleanlyWhereverItHappens) {
  const std::pair<FaultKind, rig::Device> losses[] = {
      {FaultKind::kProjectorGone, rig::Device::kProjector},
      {FaultKind::kUsbUnplugged, rig::Device::kTrigger},
      {FaultKind::kCameraRebooted, rig::Device::kCamera},
      {FaultKind::kControlStolen, rig::Device::kCamera}};
  for (const int showing : {hw_sim::kIdle, 0, 1, 44, 88}) {
    for (const auto& [kind, device] : losses) {
      SCOPED_TRACE(std::string(to_string(kind)) + " at " + std::to_string(showing));
      hw_sim::PlannedFault for_good = fault_at(kind, showing);
      for_good.duration = milliseconds(0);
      LedgerCapture capture({.faults = {for_good}});
      const rig::HostTime start = capture.rig.timeline().now();
      const RunResult result = capture.run();
      ASSERT_EQ(result.outcome, Outcome::kFailed);
      EXPECT_EQ(result.failure->incident, Incident::kDeviceLost);
      EXPECT_EQ(result.failure->device, device);
      EXPECT_EQ(capture.wrong_frame_count(), 0);
      // The capture itself takes 8 s.
      EXPECT_LT(capture.rig.timeline().now() - start,
                std::chrono::seconds(10) + capture.rig_file.sequence.reopen_deadline);
    }
  }
}

TEST(LedgerWorldCapture, NobodyToReopenALostDeviceFailsAtOnce) {
  rig::RigFile rig_file = ledger_rig_file();
  rig_file.sequence.reopen_deadline = milliseconds(0);
  LedgerCapture capture({.faults = {fault_at(FaultKind::kCameraRebooted, 20)}}, rig_file);
  const RunResult result = capture.run();
  ASSERT_EQ(result.outcome, Outcome::kFailed);
  EXPECT_EQ(result.failure->text,
            "camera: the camera is gone; see its power and its cable and start again");
  EXPECT_EQ(result.reopen_count, 0);
}

TEST(LedgerWorldCapture, TwoDevicesLostAtOnceAreBothWaitedFor) {
  hw_sim::PlannedFault box = fault_at(FaultKind::kUsbUnplugged, 20);
  box.duration = milliseconds(4000);
  LedgerCapture capture({.faults = {box, fault_at(FaultKind::kCameraRebooted, 20)}});
  const RunResult result = capture.run();
  EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
  EXPECT_EQ(result.reopen_count, 1);
  EXPECT_EQ(capture.keeper.frames.size(), 176U);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

TEST(LedgerWorldCapture, DeviceLostAgainAndAgainFails) {
  hw_sim::FaultPlan plan;
  for (const int showing : {10, 20, 30, 40})
    plan.faults.push_back(fault_at(FaultKind::kCameraRebooted, showing));
  LedgerCapture capture(plan);
  const RunResult result = capture.run();
  ASSERT_EQ(result.outcome, Outcome::kFailed);
  EXPECT_EQ(result.reopen_count, 3);
  EXPECT_EQ(result.failure->device, rig::Device::kCamera);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
}

TEST(LedgerWorldCapture, AbortIsHeardWhileALostDeviceIsWaitedFor) {
  hw_sim::PlannedFault off = fault_at(FaultKind::kCameraRebooted, 20);
  off.duration = milliseconds(0);
  LedgerCapture capture({.faults = {off}});
  std::stop_source stop;
  int refusal_count = 0;
  const RunResult result = capture.run(stop.get_token(), [&](const Transition& transition) {
    if (std::holds_alternative<ReopenRefused>(transition.event) && ++refusal_count == 3)
      stop.request_stop();
  });
  EXPECT_EQ(result.outcome, Outcome::kAborted);
  EXPECT_LE(refusal_count, 4);
}

// Aravis takes 2.5 s to say that no camera answers.
TEST(LedgerWorldCapture, AbortIsHeardInTheMidstOfAnOpening) {
  hw_sim::PlannedFault off = fault_at(FaultKind::kCameraRebooted, 20);
  off.duration = milliseconds(0);
  LedgerCapture capture({.faults = {off}}, ledger_rig_file(), {}, {}, milliseconds(2500));
  std::stop_source stop;
  rig::HostTime asked;
  const RunResult result = capture.run(stop.get_token(), [&](const Transition& transition) {
    if (transition.from != "reopening" || stop.stop_requested()) return;
    asked = transition.time;  // black was shown, the opening is under way
    stop.request_stop();
  });
  EXPECT_EQ(result.outcome, Outcome::kAborted);
  ASSERT_TRUE(stop.stop_requested());
  EXPECT_LE(capture.rig.timeline().now() - asked, 3 * hw_sim::DisplayTiming{}.refresh_interval);

  // The same devices again: what was under way is waited for, not begun twice.
  int opening_count = 0;
  const RunResult again = capture.run({}, [&](const Transition& transition) {
    opening_count += std::holds_alternative<ReopenRefused>(transition.event) ? 1 : 0;
  });
  EXPECT_EQ(again.outcome, Outcome::kFailed);
  EXPECT_EQ(again.failure->device, rig::Device::kCamera);
  // 2.5 s of opening and 0.5 s of rest
  const auto most = capture.rig_file.sequence.reopen_deadline / milliseconds(3000);
  EXPECT_NEAR(opening_count, static_cast<int>(most), 1);
}

// Whose face it is need not look into a pattern until the camera is back.
TEST(LedgerWorldCapture, IsBlackWhileALostDeviceIsWaitedFor) {
  for (const FaultKind kind : {FaultKind::kCameraRebooted, FaultKind::kUsbUnplugged}) {
    SCOPED_TRACE(std::string(to_string(kind)));
    LedgerCapture capture({.faults = {fault_at(kind, 20)}}, ledger_rig_file(), {}, {},
                          milliseconds(300));
    rig::HostTime lost;
    int look_count = 0, lit_count = 0;
    const RunResult result = capture.run({}, [&](const Transition& transition) {
      if (!std::holds_alternative<Reopening>(transition.state.phase)) return;
      if (transition.from != "reopening") lost = transition.time;
      const auto picture = hw_sim::shown_picture(capture.rig.picture_now()->id).picture;
      // What is being scanned out when the loss is told stays for its refresh.
      if (transition.time - lost < 3 * hw_sim::DisplayTiming{}.refresh_interval) return;
      ++look_count;
      lit_count += picture == rig::kBlackPicture ? 0 : 1;
    });
    EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
    EXPECT_EQ(result.reopen_count, 1);
    EXPECT_GT(look_count, 2);
    EXPECT_EQ(lit_count, 0);
    EXPECT_EQ(capture.keeper.frames.size(), 176U);
    EXPECT_EQ(capture.wrong_frame_count(), 0);
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
