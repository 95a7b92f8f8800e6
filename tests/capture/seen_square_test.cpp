// Captures of a flat phantom, on which the camera sees the sync square flip: that is no change of
// the phantom's, whatever level the square has at a repeat.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/capture/watched_capture.h"

namespace capture {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

class SeenSquare : public WatchedCapture {
 protected:
  void SetUp() override {
    WatchedCapture::SetUp();
    subject_ = Subject::kFlatPhantom;
    rig_file_.projector.sync_square.size_px = 32;  // 12 px of the frame, in its corner
  }
  void retake(int slot) {
    faults_.faults.push_back({.kind = hw_sim::FaultKind::kFrameLost,
                              .place = hw_sim::FaultPlace{hw_sim::showing_of_slot(slot), 0}});
  }
  static void expect_good(const CaptureResult& result) {
    EXPECT_THAT(result.motion, StartsWith("good: "));
    const nlohmann::json report = report_of(result);
    for (const auto& repeat : report["repeats"])
      EXPECT_TRUE(repeat["local_changes"].empty()) << repeat.dump();
    EXPECT_TRUE(report["brief_changes"].empty());
  }
};

TEST_F(SeenSquare, SaysNothingAgainstACapture) {
  expect_good(capture([](double) { return Pose{}; }));
}

TEST_F(SeenSquare, SaysNothingAfterRetakesThatShiftedItsLevels) {
  for (const int slot : {0, 1, 30, 60}) {  // of the first, of its repeat, of others
    SCOPED_TRACE(slot);
    faults_ = {};
    retake(slot);
    const CaptureResult result = capture([](double) { return Pose{}; });
    EXPECT_THAT(result.message, HasSubstr("retaken"));
    EXPECT_THAT(result.motion, StartsWith("good: "));
    EXPECT_TRUE(report_of(result)["reasons"].empty());
  }
}

TEST_F(SeenSquare, SaysNothingAfterARestartAtItsFirstShowings) {
  for (const int showing : {1, 2, 3}) {
    SCOPED_TRACE(showing);
    faults_ = {};
    faults_.faults.push_back(
        {.kind = hw_sim::FaultKind::kUsbGap, .place = hw_sim::FaultPlace{showing, 0}});
    const CaptureResult result = capture([](double) { return Pose{}; });
    EXPECT_THAT(result.motion, StartsWith("good: "));
    EXPECT_TRUE(report_of(result)["reasons"].empty());
  }
}

TEST_F(SeenSquare, SaysNothingWhereEachBracketIsAFlip) {
  rig_file_.sequence.sync = rig::SyncMode::kCameraLine;
  rig_file_.camera.trigger_edge = rig::TriggerEdge::kAny;
  rig_file_.trigger.gap = std::chrono::microseconds(20'000);
  expect_good(capture([](double) { return Pose{}; }));
  rig_file_.sequence.exposures.resize(1);
  expect_good(capture([](double) { return Pose{}; }));
}

TEST_F(SeenSquare, HidesNoChangeBesideIt) {
  const nlohmann::json still = report_of(capture([](double) { return Pose{}; }));
  for (const int slot : {-1, 50}) {  // without and with another level at the last repeats
    SCOPED_TRACE(slot);
    faults_ = {};
    if (slot >= 0) retake(slot);
    for (const std::size_t number : {2U, 3U}) {
      const double at_s = still["repeats"][number]["elapsed_s"];
      const CaptureResult result = capture([at_s](double s) {
        const double spot_light = std::abs(s - at_s) < 0.6 ? 0.5 : 1;
        return Pose{.eye_light = spot_light, .eye_row = 64, .eye_col = 72};
      });
      EXPECT_THAT(result.motion, StartsWith("usable: "));
      const nlohmann::json places = report_of(result)["repeats"][number]["local_changes"];
      ASSERT_EQ(places.size(), 1U);
      EXPECT_NEAR(places[0]["row_px"].get<double>(), 64, 8);
      EXPECT_NEAR(places[0]["col_px"].get<double>(), 72, 8);
    }
  }
}

TEST_F(SeenSquare, DoesNotKeepATakeFromBeingResumed) {
  for (const int abort_after : {40, 41, 42, 43}) {
    SCOPED_TRACE(abort_after);
    resume_.clear();
    abort_after_ = abort_after;
    const CaptureResult aborted = capture([](double) { return Pose{}; });
    abort_after_ = kToTheEnd;
    resume_ = aborted.session;
    const CaptureResult result = capture([](double) { return Pose{}; });
    EXPECT_THAT(result.motion, StartsWith("good: "));
    EXPECT_TRUE(report_of(result)["reasons"].empty());
  }
}

}  // namespace
}  // namespace capture
