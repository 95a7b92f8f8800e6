#include "tests/capture/clustered_faults.h"

#include <algorithm>
#include <initializer_list>
#include <random>

namespace capture {
namespace {

using hw_sim::FaultKind;
using std::chrono::microseconds;
using std::chrono::milliseconds;

constexpr int kShowingCount = 90;
constexpr int kLongestLight_ms = 80, kLongestReport_ms = 25, kLongestPunctualReport_ms = 17;
constexpr unsigned kLongestOpening_ms = 700;
constexpr microseconds kLeastChunklessPause{3000};
// Longer than any pattern here is shown.
constexpr unsigned kShortestGamma_ms = 700;

using Draw = std::mt19937_64;

template <typename T>
T pick(Draw& draw, std::initializer_list<T> values) {
  return *(values.begin() + draw() % values.size());
}

void draw_exposures(Draw& draw, rig::RigFile& rig_file) {
  const int shorter_ms = pick(draw, {2, 5, 10, 20});
  const int longer_ms = shorter_ms + pick(draw, {3, 10, 30, 60});
  rig_file.sequence.exposures = {milliseconds(shorter_ms), milliseconds(longer_ms)};
  if (draw() % 8 == 0) rig_file.sequence.exposures.push_back(milliseconds(longer_ms + 20));
}

hw_sim::CameraTiming draw_camera(Draw& draw, const MatrixRig& rig, rig::RigFile& rig_file) {
  hw_sim::CameraTiming camera;
  camera.readout = microseconds(pick(draw, {500, 2000, 4800}));
  camera.transfer = microseconds(pick(draw, {200, 3000, 34'000, 68'000}));
  camera.has_line_status = rig.has_line_status;
  const microseconds gap =
      std::max(camera.readout + microseconds(200), microseconds(pick(draw, {1000, 5000})));
  rig_file.sequence.readout = rig_file.trigger.gap = gap;
  // A sequencer needs chunks. Without them a stray pulse right before a pulse is not told from it.
  camera.has_chunks = rig.bracketing == rig::Bracketing::kSequencer || draw() % 2 == 0 ||
                      gap < camera.readout + kLeastChunklessPause;
  return camera;
}

hw_sim::DisplayTiming draw_display(Draw& draw, const MatrixRig& rig) {
  hw_sim::DisplayTiming display;
  display.input_lag_refreshes = static_cast<int>(draw() % 4);
  const bool must_be_punctual = rig.sync == rig::SyncMode::kSoftware || !rig.has_line_status;
  const auto longest_ms =
      static_cast<unsigned>(must_be_punctual ? kLongestPunctualReport_ms : kLongestReport_ms);
  if (draw() % 2 == 0) display.light_delay = milliseconds(draw() % (kLongestLight_ms + 1));
  if (draw() % 2 == 0) display.report_delay = milliseconds(draw() % (longest_ms + 1));
  return display;
}

hw_sim::PlannedFault draw_fault(Draw& draw, FaultKind kind, int center) {
  const int first = hw_sim::is_possible_idle(kind) ? hw_sim::kIdle : hw_sim::kPrimingShowing;
  const int showing =
      std::clamp(center + static_cast<int>(draw() % 5) - 2, first, kShowingCount - 1);
  auto fault =
      fault_at(kind, showing, static_cast<int>(draw() % 2), 1 + static_cast<int>(draw() % 3));
  const unsigned shortest_ms = kind == FaultKind::kGammaWrong ? kShortestGamma_ms : 1;
  if (fault.duration.count() > 0)
    fault.duration = milliseconds(shortest_ms + draw() % pick(draw, {30U, 100U, 400U, 3000U}));
  if (kind == FaultKind::kClockStep && draw() % 2 == 0) fault.duration = -fault.duration;
  return fault;
}

}  // namespace

const std::vector<MatrixRig>& cluster_rigs() {
  static const std::vector<MatrixRig> rigs = [] {
    std::vector<MatrixRig> all = matrix_rigs();
    all.push_back({"Sync mode trigger_box, paced, bracketing by the pulse's width",
                   rig::SyncMode::kTriggerBox, rig::Bracketing::kTriggerWidth, rig::Pace::kPaced});
    all.push_back(
        {"Sync mode camera_line, paced, with a camera that does not tell its line's level",
         rig::SyncMode::kCameraLine, rig::Bracketing::kSequencer, rig::Pace::kPaced, false});
    return all;
  }();
  return rigs;
}

Cluster draw_cluster(const MatrixRig& rig, std::uint64_t seed) {
  Draw draw(seed);
  Cluster cluster;
  cluster.rig_file = rig.rig_file();
  draw_exposures(draw, cluster.rig_file);
  cluster.camera = draw_camera(draw, rig, cluster.rig_file);
  cluster.display = draw_display(draw, rig);
  if (draw() % 3 == 0) cluster.opening_time = milliseconds(draw() % kLongestOpening_ms);
  cluster.faults.seed = draw();
  const int center = static_cast<int>(draw() % kShowingCount);
  const std::size_t count = 1 + draw() % 4;
  while (cluster.faults.faults.size() < count) {
    const auto kind = static_cast<FaultKind>(draw() % hw_sim::kFaultKindCount);
    if (rig.has_part_for(kind)) cluster.faults.faults.push_back(draw_fault(draw, kind, center));
  }
  return cluster;
}

Trial try_cluster(const Cluster& cluster) {
  return try_faults(cluster.faults, cluster.rig_file, cluster.camera, cluster.display,
                    cluster.opening_time);
}

std::string Cluster::text() const {
  std::string text("exposures");
  const auto add = [&text](const char* name, auto value) {
    text.append(name).append(std::to_string(value));
  };
  for (const microseconds exposure : rig_file.sequence.exposures) add(" ", exposure.count());
  add(" us, gap ", rig_file.trigger.gap.count());
  add(" us, readout ", camera.readout.count());
  add(" us, transfer ", camera.transfer.count());
  add(" us, lag ", display.input_lag_refreshes);
  add(" refreshes, light +", display.light_delay / milliseconds(1));
  add(" ms, report +", display.report_delay / milliseconds(1));
  add(" ms, opening ", opening_time.count());
  text.append(" ms");
  for (const auto& fault : faults.faults) {
    text.append("; ").append(to_string(fault.kind));
    add(" at ", fault.place->showing);
    add(".", fault.place->bracket);
    add(" x", fault.count);
    add(" ", fault.duration.count());
    text.append(" ms");
  }
  return text;
}

}  // namespace capture
