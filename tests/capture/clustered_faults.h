// Faults in clusters on displays and links of all kinds: one to four of any kind within a few
// showings of each other, while light, reports and frames are late. What the ledger must tell apart
// at its hardest; where single faults come out right, this is where an order can still go wrong.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/capture/fault_matrix.h"

namespace capture {

struct Cluster {
  rig::RigFile rig_file;
  hw_sim::CameraTiming camera;
  hw_sim::DisplayTiming display;
  hw_sim::FaultPlan faults;
  std::chrono::milliseconds opening_time{0};

  std::string text() const;  // for a finding, one line
};

// The rigs of the matrix and those that it leaves out.
const std::vector<MatrixRig>& cluster_rigs();

// Drawn from a seed. A gamma ramp that is bent for less than a pattern takes is left out (nobody
// sees it), and so are cameras without chunks under a gap that is hardly longer than their readout.
Cluster draw_cluster(const MatrixRig& rig, std::uint64_t seed);

Trial try_cluster(const Cluster& cluster);

}  // namespace capture
