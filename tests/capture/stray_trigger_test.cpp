// A stray trigger whose frame takes the place of the next flip's: told by the level of the camera's
// line, or, where the camera does not tell it, by a display that keeps time.
#include <gtest/gtest.h>

#include "tests/capture/ledger_rig.h"

namespace capture {
namespace {

using hw_sim::FaultKind;
using std::chrono::microseconds;
using std::chrono::milliseconds;

constexpr int kSlot = 43;

// What decides whether the flip's own edge is seen after the stray's frame, and as whose.
struct Circumstances {
  milliseconds report_delay{0}, light_delay{0};  // of the display
  milliseconds exposure{8};                      // of the longer bracket
  int bracket = 0;                               // after which the stray comes
  rig::Pace pace = rig::Pace::kHandshake;
  bool is_flip_late = false;  // the one that the stray comes instead of
};

struct Tried {
  RunResult result;
  std::map<Incident, int> incidents;
  int wrong_frame_count = 0;
  std::size_t frame_count = 0;
};

Tried try_stray(const Circumstances& tried, bool has_line_status) {
  rig::RigFile rig_file = boxless_rig_file(rig::SyncMode::kCameraLine);
  rig_file.sequence.exposures = {milliseconds(5), tried.exposure};
  rig_file.sequence.readout = microseconds(500);
  rig_file.sequence.pace = tried.pace;
  // A camera and a link as quick as can be: a stray frame is there before the picture was shown.
  hw_sim::CameraTiming camera;
  camera.transfer = microseconds(200);
  camera.has_line_status = has_line_status;
  hw_sim::DisplayTiming display;
  display.input_lag_refreshes = 0;
  display.report_delay = tried.report_delay;
  display.light_delay = tried.light_delay;
  hw_sim::FaultPlan plan;
  const int showing = hw_sim::showing_of_slot(kSlot);
  plan.faults.push_back(fault_at(FaultKind::kTriggerDoubled, showing, tried.bracket));
  if (tried.is_flip_late) {
    plan.faults.push_back(fault_at(FaultKind::kFlipLate, showing, 1));
    plan.faults.back().duration = milliseconds(40);
  }
  LedgerCapture capture(plan, rig_file, camera, display);
  Tried done{capture.run(), {}, 0, 0};
  done.incidents = capture.incidents;
  done.wrong_frame_count = capture.wrong_frame_count();
  done.frame_count = capture.keeper.frames.size();
  return done;
}

void expect_promise(const Tried& tried) {
  EXPECT_EQ(tried.wrong_frame_count, 0);
  if (tried.result.outcome == Outcome::kComplete)
    EXPECT_EQ(tried.frame_count, tried.result.slots.size());
  else
    EXPECT_TRUE(tried.result.failure && !tried.result.failure->text.empty());
}

TEST(StrayTrigger, ShowsTheLevelOfBefore) {
  const Tried tried = try_stray({}, true);
  expect_promise(tried);
  EXPECT_EQ(tried.result.outcome, Outcome::kComplete);
  EXPECT_EQ(tried.incidents.at(Incident::kEdgeWrongLevel), 1);
}

TEST(StrayTrigger, IsToldByTheDisplayWhereTheCameraDoesNotTellTheLevel) {
  const Tried tried = try_stray({}, false);
  expect_promise(tried);
  EXPECT_EQ(tried.result.outcome, Outcome::kComplete);
  EXPECT_FALSE(tried.incidents.contains(Incident::kEdgeWrongLevel));
  EXPECT_FALSE(tried.incidents.empty());
}

TEST(StrayTrigger, FillsNoSlotOnAnyDisplay) {
  int complete_count = 0, trial_count = 0;
  for (const bool has_line_status : {true, false})
    for (const rig::Pace pace : {rig::Pace::kHandshake, rig::Pace::kPaced})
      for (const int report_ms : {0, 15, 30, 60})
        for (const int light_ms : {0, 10, 20, 40, 70})
          for (const int exposure_ms : {8, 25})
            for (const int bracket : {0, 1})
              for (const bool is_flip_late : {false, true}) {
                SCOPED_TRACE("level " + std::to_string(has_line_status) + ", paced " +
                             std::to_string(pace == rig::Pace::kPaced) + ", report +" +
                             std::to_string(report_ms) + " ms, light +" + std::to_string(light_ms) +
                             " ms, exposure " + std::to_string(exposure_ms) + " ms, bracket " +
                             std::to_string(bracket) + ", late " + std::to_string(is_flip_late));
                const Tried tried =
                    try_stray({milliseconds(report_ms), milliseconds(light_ms),
                               milliseconds(exposure_ms), bracket, pace, is_flip_late},
                              has_line_status);
                expect_promise(tried);
                ++trial_count;
                if (tried.result.outcome == Outcome::kComplete) ++complete_count;
              }
  EXPECT_GT(complete_count, trial_count / 2);
}

TEST(StrayTrigger, ADisplayThatSwapsLateIsNoEvidence) {
  const Tried tried = try_stray({.report_delay = milliseconds(60)}, false);
  EXPECT_EQ(tried.result.outcome, Outcome::kFailed);
  ASSERT_TRUE(tried.result.failure);
  EXPECT_EQ(tried.result.failure->incident, Incident::kPictureLate);
  EXPECT_NE(tried.result.failure->text.find("vertical sync"), std::string::npos);
}

TEST(UnsynchronisedDisplay, IsRefusedBeforeArmingWhereNothingElseTellsTheLevel) {
  for (const auto sync :
       {rig::SyncMode::kTriggerBox, rig::SyncMode::kCameraLine, rig::SyncMode::kSoftware}) {
    for (const bool has_line_status : {true, false}) {
      hw_sim::CameraTiming camera;
      camera.has_line_status = has_line_status;
      hw_sim::DisplayTiming display;
      display.is_synchronised = false;
      LedgerCapture capture(
          {}, sync == rig::SyncMode::kTriggerBox ? ledger_rig_file() : boxless_rig_file(sync),
          camera, display);
      const RunResult result = capture.run();
      const bool is_refused = sync == rig::SyncMode::kSoftware ||
                              (sync == rig::SyncMode::kCameraLine && !has_line_status);
      EXPECT_EQ(result.outcome, is_refused ? Outcome::kFailed : Outcome::kComplete);
      if (!is_refused) continue;
      ASSERT_TRUE(result.failure);
      EXPECT_EQ(result.failure->device, rig::Device::kProjector);
      EXPECT_NE(result.failure->text.find("not synchronised"), std::string::npos);
      EXPECT_NE(result.failure->text.find("sequence.sync"), std::string::npos);
      EXPECT_EQ(capture.keeper.frame_count, 0);
    }
  }
}

}  // namespace
}  // namespace capture
