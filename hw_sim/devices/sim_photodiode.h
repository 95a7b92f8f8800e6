// The photodiode of the in-process rig, in front of the sync square.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>

#include "hw_sim/devices/timeline.h"
#include "hw_sim/faults/fault_schedule.h"

namespace hw_sim {

// Not thread-safe: lives on its Timeline's thread.
class SimPhotodiode {
 public:
  // Called at each change of the level, in ADC counts 0..1023.
  using OnLevel = std::function<void(int level_adc)>;

  SimPhotodiode(Timeline& timeline, OnLevel on_level)
      : timeline_(timeline), on_level_(std::move(on_level)) {}

  // The square of the picture whose light begins now.
  void square(bool is_light, const FlipFaults& faults = {});

  // Faults that last.
  void stick(bool is_stuck);
  void dim(double level_frac);  // 1: as it was
  // Those that happen when a picture is exposed, or at rest.
  void take_faults(FaultSchedule& faults);

 private:
  void read(int level_adc);
  void disturb(rig::HostTime start, std::chrono::microseconds duration);
  void fall_slowly(std::chrono::milliseconds time_constant);
  int level_now() const;

  Timeline& timeline_;
  const OnLevel on_level_;
  std::uint64_t level_number_ = 0;  // of the latest level: a slow fall to it is void
  bool is_square_light_ = false;    // as it sees it
  bool is_true_square_light_ = false;
  bool is_stuck_ = false;
  double level_frac_ = 1;
};

}  // namespace hw_sim
