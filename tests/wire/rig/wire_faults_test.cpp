// Plans of faults carried out over the real wires, against the production drivers: what comes out
// is complete and right to the last frame, or failed with its cause.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "hw_sim/display/child_process.h"
#include "hw_sim/faults/fault_plan.h"
#include "tests/wire/rig/ledger_session.h"

namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr auto kPatience = std::chrono::seconds(150);
constexpr int kDone = 0, kUsage = 2, kDevice = 3;

class WireFaults : public testing::Test {
 public:
  WireFaults() {
    std::string name = "/tmp/wfault.XXXXXX";
    folder_ = mkdtemp(name.data());
    fs::create_directory(folder_ / "tmp");
    fs::copy(LEDGER_RIG, rig_file());
    fs::copy(fs::path(LEDGER_RIG).parent_path() / "ledger_calibration.json", folder_);
  }
  ~WireFaults() override { fs::remove_all(folder_); }

 protected:
  fs::path rig_file() const { return folder_ / "rig.toml"; }
  void wait_for_devices_for(std::chrono::milliseconds time) const {
    std::ifstream in(rig_file());
    std::string rig{std::istreambuf_iterator<char>(in), {}};
    const std::string section = "[sequence]\n";
    rig.insert(rig.find(section) + section.size(),
               "reopen_deadline_ms = " + std::to_string(time.count()) + "\n");
    std::ofstream(rig_file()) << rig;
  }
  // The exit code of `ssrig capture` under a plan.
  int capture(const std::string& plan) {
    std::ofstream(folder_ / "plan.toml") << plan;
    auto child = hw_sim::ChildProcess::start(
        {.argv = {SSRIG_SIM, "run", "--rig", rig_file(), "--scene", "ledger", "--faults",
                  folder_ / "plan.toml", "--", SSRIG, "capture", "--rig", rig_file(), "--out",
                  out()},
         .environment = {{"TMPDIR", (folder_ / "tmp").string()}},
         .output = folder_ / "output"});
    EXPECT_TRUE(child) << child.error().detail;
    if (!child) return -1;
    const auto code = child->wait(rig::HostClock::now() + kPatience);
    EXPECT_TRUE(code) << "still running: " << output();
    return code.value_or(-1);
  }
  void expect_complete_and_right() const {
    const LedgerSession session = read_ledger_session(only_session(), LEDGER_RIG);
    EXPECT_EQ(session.state, "complete") << output();
    EXPECT_EQ(session.frame_count, 176);
    EXPECT_THAT(session.wrong_frames, IsEmpty()) << output();
    EXPECT_THAT(output(), Not(HasSubstr("found no occasion")));
  }
  void expect_failed_and_nothing_wrong() const {
    const LedgerSession session = read_ledger_session(only_session(), LEDGER_RIG);
    EXPECT_EQ(session.state, "failed") << output();
    EXPECT_THAT(session.wrong_frames, IsEmpty()) << output();
  }

  fs::path out() const { return folder_ / "out"; }
  fs::path only_session() const {
    std::vector<fs::path> found;
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(out(), none)) found.push_back(entry.path());
    EXPECT_EQ(found.size(), 1U) << output();
    return found.empty() ? folder_ : found.front();
  }
  std::string output() const {
    std::ifstream file(folder_ / "output");
    return {std::istreambuf_iterator<char>(file), {}};
  }

 private:
  fs::path folder_;
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
  EXPECT_EQ(read_ledger_session(only_session(), LEDGER_RIG).wrong_frames.size(), 2U);
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
  wait_for_devices_for(std::chrono::milliseconds(2000));
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
  EXPECT_FALSE(fs::exists(out()));
}

}  // namespace
