// Plans of faults carried out over the real wires, against the production drivers: what comes out
// is complete and right to the last frame, or failed with its cause.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <string>

#include "hw_sim/faults/fault_plan.h"
#include "tests/wire/rig/wire_capture.h"

namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int kDone = 0, kUsage = 2, kDevice = 3;

class WireFaults : public testing::Test {
 protected:
  int capture(const std::string& plan) const { return wire_.run(plan); }
  void expect_complete_and_right() const {
    const LedgerSession session = wire_.judge(only_session());
    EXPECT_EQ(session.state, "complete") << output();
    EXPECT_EQ(session.frame_count, 176);
    EXPECT_THAT(session.wrong_frames, IsEmpty()) << output();
    EXPECT_THAT(output(), Not(HasSubstr("found no occasion")));
  }
  void expect_failed_and_nothing_wrong() const {
    const LedgerSession session = wire_.judge(only_session());
    EXPECT_EQ(session.state, "failed") << output();
    EXPECT_THAT(session.wrong_frames, IsEmpty()) << output();
  }
  // A busy machine's display does not keep time, and then nothing may be called complete where only
  // the display tells what was shown.
  void expect_right_unless_display_is_late(int code) const {
    const bool is_late = output().find("not synchronised: swaps") != std::string::npos ||
                         output().find("picture late after") != std::string::npos;
    if (is_late) {
      EXPECT_NE(code, kDone) << output();
      return expect_failed_and_nothing_wrong();
    }
    EXPECT_EQ(code, kDone) << output();
    expect_complete_and_right();
  }
  fs::path only_session() const {
    const auto found = wire_.sessions();
    EXPECT_EQ(found.size(), 1U) << output();
    return found.empty() ? fs::path() : found.front();
  }
  std::string output() const { return wire_.output(); }

  WireCapture wire_;
};

// Every fault that is over with the picture it spoils, each once.
TEST_F(WireFaults, AllThatPassGoUnseenInTheSession) {
  std::string plan = "seed = 3\nfaults = [\n";
  int slot = 1;
  for (int kind = 0; kind < static_cast<int>(hw_sim::FaultKind::kUsbUnplugged); ++kind) {
    plan += "{fault = \"";
    plan += to_string(static_cast<hw_sim::FaultKind>(kind));
    plan += "\", slot = " + std::to_string(slot) + "},\n";
    slot += 3;
  }
  EXPECT_EQ(capture(plan + "]\n"), kDone) << output();
  expect_complete_and_right();

  // And the judge sees two frames that have changed places.
  const fs::path frames = only_session() / "frames";
  fs::rename(frames / "pattern_010_bracket_0.tiff", frames / "kept.tiff");
  fs::rename(frames / "pattern_011_bracket_0.tiff", frames / "pattern_010_bracket_0.tiff");
  fs::rename(frames / "kept.tiff", frames / "pattern_011_bracket_0.tiff");
  EXPECT_EQ(wire_.judge(only_session()).wrong_frames.size(), 2U);
}

// The photodiode on the camera's line: no trigger box is plugged in.
TEST_F(WireFaults, CameraLineNeedsNoTriggerBox) {
  wire_.set_mode({.sync = "camera_line"});
  std::string plan = "seed = 3\nfaults = [\n";
  int slot = 5;
  for (const char* fault :
       {"frame_truncated", "trigger_doubled", "sequencer_slip", "light_flash"}) {
    plan +=
        std::string("{fault = \"").append(fault) + "\", slot = " + std::to_string(slot) + "},\n";
    slot += 10;
  }
  EXPECT_EQ(capture(plan + "]\n"), kDone) << output();
  expect_complete_and_right();
}

// Then only a display that keeps time tells a stray trigger from a flip.
TEST_F(WireFaults, CameraLineWithoutItsLevelNeedsThePunctualDisplay) {
  wire_.set_mode({.sync = "camera_line", .has_line_status = false});
  const int code = capture("faults = [{fault = \"trigger_doubled\", slot = 43}]\n");
  EXPECT_NE(output().find("chunk LineStatusAll"), std::string::npos) << output();
  expect_right_unless_display_is_late(code);
}

// No photodiode: the program measures how late it has to trigger, then does.
TEST_F(WireFaults, SoftwareTriggerNeedsNoPhotodiode) {
  wire_.set_mode({.sync = "software"});
  expect_right_unless_display_is_late(capture(""));
}

TEST_F(WireFaults, PacedIsRightToo) {
  wire_.set_mode({.pace = "paced"});
  EXPECT_EQ(capture(""), kDone) << output();
  expect_complete_and_right();
}

// Every device that can be lost, three to a capture, which is how often one waits for them.
TEST_F(WireFaults, LostDevicesAreWaitedForAndTheOpenSlotsTaken) {
  EXPECT_EQ(capture("faults = [{fault = \"camera_rebooted\", slot = 10},\n"
                    "{fault = \"projector_gone\", slot = 30},\n"
                    "{fault = \"usb_unplugged\", slot = 60}]\n"),
            kDone)
      << output();
  expect_complete_and_right();
}

TEST_F(WireFaults, StolenControlPulledCableAndBentGammaAreWaitedFor) {
  EXPECT_EQ(capture("faults = [{fault = \"control_stolen\", slot = 10},\n"
                    "{fault = \"cable_pulled\", slot = 30},\n"
                    "{fault = \"gamma_wrong\", slot = 87}]\n"),
            kDone)
      << output();
  expect_complete_and_right();
}

TEST_F(WireFaults, DeviceThatStaysAwayFailsTheCaptureWithItsName) {
  wire_.set_reopen_deadline(std::chrono::milliseconds(2000));
  EXPECT_EQ(capture("faults = [{fault = \"usb_unplugged\", slot = 87, duration_ms = 0}]\n"),
            kDevice)
      << output();
  expect_failed_and_nothing_wrong();
  EXPECT_THAT(output(), HasSubstr("trigger box: lost, and not back within 2 s: no trigger box"));
}

TEST_F(WireFaults, BadPlanIsNamedWithItsLine) {
  EXPECT_EQ(capture("faults = [\n  {fault = \"frame_lots\", slot = 3},\n]\n"), kUsage);
  EXPECT_THAT(output(),
              HasSubstr("plan.toml:2: \"frame_lots\" is no fault; there are packet_loss"));
  EXPECT_THAT(wire_.sessions(), IsEmpty());
}

}  // namespace
