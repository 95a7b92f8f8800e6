// One `ssrig capture` against ssrig-sim's scene "ledger" under a plan of faults, in a folder of its
// own that goes with it.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

#include "hw_sim/display/child_process.h"
#include "hw_sim/faults/fault_plan.h"
#include "rig/fault.h"
#include "tests/temporary_folder.h"
#include "tests/wire/rig/ledger_session.h"

// A sync mode and a pace, by their names in a rig file, and with "without-line-status" a camera
// that does not tell the level of its line.
struct WireMode {
  std::string sync = "trigger_box", pace = "handshake";
  bool has_line_status = true;  // the camera tells the level of its line

  // The first words' that there are.
  static WireMode of(int word_count, const char* const* words);
  // The text of ledger.toml as a rig file of this mode: without a box that has no part in it.
  std::string rig_text(std::string toml) const;
  // Has such a rig what this fault befalls, and can it see it?
  bool has_part_for(hw_sim::FaultKind kind) const;
};

class WireCapture {
 public:
  static constexpr int kHangs = -1;  // instead of an exit code

  WireCapture();

  // Into the rig file's [sequence], before run().
  void set_reopen_deadline(std::chrono::milliseconds time) const;
  void set_mode(const WireMode& mode);
  // The exit code; once. `plan` is a plan of faults in TOML.
  int run(const std::string& plan) const;
  // The same in two steps; and ssrig by itself, without a rig around it.
  rig::Result<hw_sim::ChildProcess> start(const std::string& plan) const;
  rig::Result<hw_sim::ChildProcess> start_without_rig() const;
  static int ended(hw_sim::ChildProcess& child);

  std::string output() const;
  std::vector<std::filesystem::path> sessions() const;
  LedgerSession judge(const std::filesystem::path& session) const;

 private:
  std::filesystem::path rig_file() const { return folder_ / "rig.toml"; }
  const test_support::TemporaryFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path();
  bool has_line_status_ = true;
};
