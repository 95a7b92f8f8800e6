// The triggered exposure of a GigE area camera without its wires: which pulse becomes a frame, for
// how long, with which sequencer set. Pure: time comes in as an argument. Used by the in-process
// camera and by the GigE Vision device.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "rig/camera.h"
#include "rig/clock.h"

namespace hw_sim {

struct ExposureJob {
  std::uint64_t trigger_number = 0;  // pulses seen since start(), this one included
  rig::HostTime start;
  std::chrono::microseconds duration{0};
  int sequencer_set = -1;  // -1 outside sequencer mode
  rig::HostTime end() const { return start + duration; }
};

class ExposureEngine {
 public:
  static constexpr int kSetCount = 8;
  struct SequencerSet {
    std::chrono::microseconds exposure{10000};
    int next_set = 0;
  };

  // What decides an exposure's length: the sequencer when it is on, else the pulse's width under
  // kTriggerWidth, else `fixed_exposure`.
  rig::Bracketing bracketing = rig::Bracketing::kSequencer;
  std::array<SequencerSet, kSetCount> sets;
  int start_set = 0;
  std::chrono::microseconds fixed_exposure{10000};
  bool is_sequencer_on = false;
  std::chrono::microseconds readout{500};  // busy after the exposure

  // Counters to zero, sequencer to its start set, not busy.
  void start();
  // A pulse of `width` on the line at `time`. nullopt: the camera was exposing or reading out, and
  // the pulse is counted as missed; it moves no sequencer.
  std::optional<ExposureJob> trigger(rig::HostTime time, std::chrono::microseconds width);

  std::uint64_t trigger_count() const { return trigger_count_; }
  std::uint64_t missed_count() const { return missed_count_; }
  int active_set() const { return active_set_; }
  bool is_busy(rig::HostTime time) const { return time < busy_until_; }
  // The fault of a sequencer out of step: it moves on without a pulse.
  void slip() { active_set_ = sets[index(active_set_)].next_set; }

 private:
  static std::size_t index(int set) { return static_cast<std::size_t>(set) % kSetCount; }

  rig::HostTime busy_until_ = rig::HostTime::min();
  std::uint64_t trigger_count_ = 0;
  std::uint64_t missed_count_ = 0;
  int active_set_ = 0;
};

}  // namespace hw_sim
