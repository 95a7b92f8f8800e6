#include "tests/capture/fault_matrix.h"

#include <algorithm>
#include <cstdio>
#include <stop_token>

namespace capture {
namespace {

using hw_sim::FaultKind;
using hw_sim::FaultSite;
using std::chrono::duration_cast;
using std::chrono::milliseconds;

// A capture of 176 frames has some 900 transitions.
constexpr int kTransitionLimit = 100'000;
constexpr char kBegin[] = "<!-- fault matrix: begin -->\n";
constexpr char kEnd[] = "<!-- fault matrix: end -->\n";

std::string joined(const std::set<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text.append(text.empty() ? "" : ", ").append(word);
  return text.empty() ? "nothing" : text;
}

std::string seconds(milliseconds duration) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f s", static_cast<double>(duration.count()) / 1000);
  return text;
}

MatrixCell run_cell(std::size_t fault, std::size_t place, std::size_t rig) {
  MatrixCell cell{fault, place, rig, {}};
  const MatrixRig& tried = matrix_rigs()[rig];
  const FaultKind kind = matrix_faults()[fault].fault.kind;
  const int showing = matrix_places()[place].showing;
  if (!tried.has_part_for(kind)) return cell;
  if (showing == hw_sim::kIdle && !hw_sim::is_possible_idle(kind)) return cell;
  const int bracket_count =
      hw_sim::site_of(kind) == FaultSite::kShot && showing != hw_sim::kIdle ? 2 : 1;
  for (int bracket = 0; bracket < bracket_count; ++bracket) {
    for (const bool has_chunks : {true, false}) {
      if (!has_chunks && tried.bracketing == rig::Bracketing::kSequencer)
        continue;  // refused at arming
      hw_sim::CameraTiming timing;
      timing.has_chunks = has_chunks;
      timing.has_line_status = tried.has_line_status;
      hw_sim::PlannedFault planned = matrix_faults()[fault].fault;
      planned.place = hw_sim::FaultPlace{showing, bracket};
      cell.trials.push_back(try_faults({.faults = {planned}}, tried.rig_file(), timing));
    }
  }
  return cell;
}

const MatrixCell* find(const std::vector<MatrixCell>& cells, std::size_t fault, std::size_t place,
                       std::size_t rig) {
  for (const MatrixCell& cell : cells)
    if (cell.fault == fault && cell.place == place && cell.rig == rig) return &cell;
  return nullptr;
}

std::string outcome_text(const MatrixCell& cell, milliseconds faultless) {
  if (cell.trials.empty()) return "-";
  milliseconds longest{0};
  int failed_count = 0;
  for (const Trial& trial : cell.trials) {
    longest = std::max(longest, trial.duration - faultless);
    if (trial.outcome != Outcome::kComplete) ++failed_count;
  }
  if (failed_count == static_cast<int>(cell.trials.size())) return "failed";
  std::string text("+");
  text.append(longest > milliseconds(0) ? seconds(longest) : "0");
  if (failed_count > 0)
    text.append(", ")
        .append(std::to_string(failed_count))
        .append(" of ")
        .append(std::to_string(cell.trials.size()))
        .append(" failed");
  return text;
}

std::string row(const std::vector<MatrixCell>& cells, std::size_t fault, std::size_t rig,
                milliseconds faultless) {
  std::set<std::string> detected, done;
  std::string outcomes;
  for (std::size_t place = 0; place < matrix_places().size(); ++place) {
    const MatrixCell& cell = *find(cells, fault, place, rig);
    for (const Trial& trial : cell.trials) {
      detected.insert(trial.detected.begin(), trial.detected.end());
      done.insert(trial.done.begin(), trial.done.end());
    }
    outcomes.append(" ").append(outcome_text(cell, faultless)).append(" |");
  }
  return std::string("| ")
      .append(matrix_faults()[fault].name)
      .append(" | ")
      .append(joined(detected))
      .append(" | ")
      .append(joined(done))
      .append(" |")
      .append(outcomes)
      .append("\n");
}

}  // namespace

Trial try_faults(const hw_sim::FaultPlan& plan, const rig::RigFile& rig_file,
                 const hw_sim::CameraTiming& camera_timing,
                 const hw_sim::DisplayTiming& display_timing,
                 std::chrono::milliseconds opening_time) {
  LedgerCapture capture(plan, rig_file, camera_timing, display_timing, opening_time);
  Trial trial;
  std::stop_source stop;
  int transition_count = 0;
  const rig::HostTime start = capture.rig.timeline().now();
  const RunResult result = capture.run(stop.get_token(), [&](const Transition& transition) {
    for (const Reacted& reacted : transition.reacted) {
      trial.detected.emplace(to_string(reacted.finding.incident));
      trial.done.emplace(to_string(reacted.reaction));
    }
    if (++transition_count > kTransitionLimit) stop.request_stop();
  });
  trial.duration = duration_cast<milliseconds>(capture.rig.timeline().now() - start);
  trial.outcome = result.outcome;
  trial.wrong_frame_count = capture.wrong_frame_count();
  trial.is_falsely_complete =
      result.outcome == Outcome::kComplete && capture.keeper.frames.size() != result.slots.size();
  trial.is_hung = result.outcome == Outcome::kAborted;
  if (result.failure) trial.text = result.failure->text;
  return trial;
}

const std::vector<MatrixPlace>& matrix_places() {
  static const std::vector<MatrixPlace> places = {
      {"idle", hw_sim::kIdle},
      {"priming", hw_sim::kPrimingShowing},
      {"first slot", hw_sim::showing_of_slot(0)},
      {"middle slot", hw_sim::showing_of_slot(43)},
      {"last slot", hw_sim::showing_of_slot(87)},
  };
  return places;
}

const std::vector<MatrixFault>& matrix_faults() {
  static const std::vector<MatrixFault> faults = [] {
    std::vector<MatrixFault> made;
    for (int kind = 0; kind < hw_sim::kFaultKindCount; ++kind) {
      MatrixFault fault{std::string(to_string(static_cast<FaultKind>(kind))),
                        hw_sim::default_fault(static_cast<FaultKind>(kind))};
      const bool lasts = hw_sim::site_of(fault.fault.kind) == FaultSite::kTrain &&
                         fault.fault.duration.count() > 0;
      MatrixFault for_good = fault;
      if (lasts) fault.name += ", " + seconds(fault.fault.duration);
      made.push_back(std::move(fault));
      if (!lasts || for_good.fault.kind == FaultKind::kUsbSilent) continue;
      for_good.name += ", for good";
      for_good.fault.duration = milliseconds(0);
      made.push_back(std::move(for_good));
    }
    return made;
  }();
  return faults;
}

rig::RigFile MatrixRig::rig_file() const {
  rig::RigFile rig_file =
      sync == rig::SyncMode::kTriggerBox ? ledger_rig_file() : boxless_rig_file(sync);
  rig_file.camera.bracketing = bracketing;
  rig_file.sequence.pace = pace;
  return rig_file;
}

bool MatrixRig::has_part_for(FaultKind kind) const {
  switch (kind) {
    case FaultKind::kUsbStall:
    case FaultKind::kUsbGap:
    case FaultKind::kUsbSilent:
    case FaultKind::kUsbUnplugged:
      return sync == rig::SyncMode::kTriggerBox;
    case FaultKind::kEdgeMissed:
    case FaultKind::kEdgeBounced:
    case FaultKind::kLightFlash:
    case FaultKind::kPhotodiodeSlowFall:
    case FaultKind::kPhotodiodeStuck:
    case FaultKind::kPhotodiodeDim:
    case FaultKind::kFlipLate:  // which nobody can see there
      return sync != rig::SyncMode::kSoftware;
    default:
      return true;
  }
}

const std::vector<MatrixRig>& matrix_rigs() {
  using enum rig::SyncMode;
  using enum rig::Bracketing;
  static const std::vector<MatrixRig> rigs = {
      {"Sync mode trigger_box, bracketing by the camera's sequencer", kTriggerBox, kSequencer},
      {"Sync mode trigger_box, bracketing by the pulse's width", kTriggerBox, kTriggerWidth},
      {"Sync mode trigger_box, paced", kTriggerBox, kSequencer, rig::Pace::kPaced},
      {"Sync mode camera_line", kCameraLine, kSequencer},
      {"Sync mode camera_line, paced", kCameraLine, kSequencer, rig::Pace::kPaced},
      {"Sync mode camera_line, with a camera that does not tell the level of its line", kCameraLine,
       kSequencer, rig::Pace::kHandshake, false},
      {"Sync mode software", kSoftware, kSequencer},
  };
  return rigs;
}

std::vector<MatrixCell> run_fault_matrix() {
  std::vector<MatrixCell> cells;
  for (std::size_t rig = 0; rig < matrix_rigs().size(); ++rig)
    for (std::size_t fault = 0; fault < matrix_faults().size(); ++fault)
      for (std::size_t place = 0; place < matrix_places().size(); ++place)
        cells.push_back(run_cell(fault, place, rig));
  return cells;
}

std::string fault_matrix_table(const std::vector<MatrixCell>& cells) {
  std::string text;
  std::size_t trial_count = 0;
  for (const MatrixCell& cell : cells) trial_count += cell.trials.size();
  for (std::size_t rig = 0; rig < matrix_rigs().size(); ++rig) {
    hw_sim::CameraTiming timing;
    timing.has_line_status = matrix_rigs()[rig].has_line_status;
    const milliseconds faultless = try_faults({}, matrix_rigs()[rig].rig_file(), timing).duration;
    text += matrix_rigs()[rig].name + "; without a fault a capture takes " + seconds(faultless) +
            ".\n\n| fault | detected | done |";
    for (const MatrixPlace& place : matrix_places())
      text.append(" ").append(place.name).append(" |");
    text += "\n|---|---|---|";
    for (std::size_t i = 0; i < matrix_places().size(); ++i) text += "---|";
    text += "\n";
    for (std::size_t fault = 0; fault < matrix_faults().size(); ++fault)
      if (matrix_rigs()[rig].has_part_for(matrix_faults()[fault].fault.kind))
        text += row(cells, fault, rig, faultless);
    text += "\n";
  }
  int wrong_count = 0, false_count = 0, hung_count = 0;
  for (const MatrixCell& cell : cells) {
    for (const Trial& trial : cell.trials) {
      wrong_count += trial.wrong_frame_count;
      false_count += trial.is_falsely_complete ? 1 : 0;
      hung_count += trial.is_hung ? 1 : 0;
    }
  }
  return text + std::to_string(trial_count) +
         " captures. Frames assigned to a wrong slot: " + std::to_string(wrong_count) +
         ". Hangs: " + std::to_string(hung_count) +
         ". Captures called complete that are not: " + std::to_string(false_count) + ".\n";
}

std::string with_fault_matrix(const std::string& readme, const std::string& table) {
  const std::size_t begin = readme.find(kBegin), end = readme.find(kEnd);
  if (begin == std::string::npos || end == std::string::npos) return readme;
  return readme.substr(0, begin) + kBegin + table + readme.substr(end);
}

}  // namespace capture
