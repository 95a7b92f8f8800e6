// What goes wrong in the in-process rig, and when: a plan of faults.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <set>

namespace hw_sim {

// Numbers count from 1 since the rig was made, whatever is armed in between, so that each fault
// happens once and its retake is spared.
struct SimFaults {
  std::set<std::uint64_t> late_flips;       // shows whose light comes `flip_delay` late
  std::set<std::uint64_t> missed_edges;     // changes of the square unseen until the next picture
  std::set<std::uint64_t> light_flashes;    // trains during which the photodiode sees a flash
  std::set<std::uint64_t> dropped_pulses;   // raised by the box, never seen by the camera
  std::set<std::uint64_t> dropped_frames;   // exposed, lost on the way
  std::set<std::uint64_t> damaged_frames;   // exposed, arriving incomplete
  std::set<std::uint64_t> repeated_frames;  // arriving twice
  std::set<std::uint64_t> late_frames;      // arriving `frame_delay` late
  std::set<std::uint64_t> slips;            // pulses before which the sequencer loses step
  std::chrono::microseconds flip_delay{33'333};
  std::chrono::milliseconds frame_delay{400};
  // The device disappears at its n-th show, edge, pulse.
  std::optional<std::uint64_t> projector_lost_at_show;
  std::optional<std::uint64_t> trigger_lost_at_edge;
  std::optional<std::uint64_t> camera_lost_at_pulse;
};

}  // namespace hw_sim
