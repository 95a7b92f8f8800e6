// Every fault of hw_sim at the first, a middle and the last slot, at the priming and while idle:
// what capture makes of it, in the ledger world, where every frame says itself whose it is.
#pragma once

#include <chrono>
#include <set>
#include <string>
#include <vector>

#include "tests/capture/ledger_rig.h"

namespace capture {

// One capture under a plan of faults.
struct Trial {
  Outcome outcome = Outcome::kFailed;
  std::set<std::string> detected;         // incidents
  std::set<std::string> done;             // reactions
  std::chrono::milliseconds duration{0};  // virtual
  int wrong_frame_count = 0;
  bool is_falsely_complete = false;
  bool is_hung = false;
  std::string text;  // why it failed
};
Trial try_faults(const hw_sim::FaultPlan& plan, const rig::RigFile& rig_file,
                 const hw_sim::CameraTiming& camera_timing = {},
                 const hw_sim::DisplayTiming& display_timing = {},
                 std::chrono::milliseconds opening_time = {});

struct MatrixPlace {
  std::string name;
  int showing = 0;
};
const std::vector<MatrixPlace>& matrix_places();

// A fault as the matrix tries it.
struct MatrixFault {
  std::string name;
  hw_sim::PlannedFault fault;  // its place is the cell's
};
const std::vector<MatrixFault>& matrix_faults();

// A rig that the matrix tries the faults on.
struct MatrixRig {
  std::string name;
  rig::SyncMode sync = rig::SyncMode::kTriggerBox;
  rig::Bracketing bracketing = rig::Bracketing::kSequencer;
  rig::Pace pace = rig::Pace::kHandshake;
  bool has_line_status = true;  // the camera tells the level of its line

  rig::RigFile rig_file() const;
  bool has_part_for(hw_sim::FaultKind kind) const;
};
const std::vector<MatrixRig>& matrix_rigs();

struct MatrixCell {
  std::size_t fault = 0;      // of matrix_faults()
  std::size_t place = 0;      // of matrix_places()
  std::size_t rig = 0;        // of matrix_rigs()
  std::vector<Trial> trials;  // a bracket each, with and without chunks; empty: cannot happen there
};

// All cells, and the captures behind them.
std::vector<MatrixCell> run_fault_matrix();
// As Markdown.
std::string fault_matrix_table(const std::vector<MatrixCell>& cells);

// `readme` with the table between its marks replaced; unchanged without marks.
std::string with_fault_matrix(const std::string& readme, const std::string& table);

}  // namespace capture
