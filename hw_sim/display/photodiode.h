// The photodiode in front of the sync square, with the comparator's input as the trigger box reads
// it.
#pragma once

#include <chrono>
#include <vector>

#include "rig/clock.h"

namespace hw_sim {

struct PhotodiodeSettings {
  int dark_adc = 100;  // reading of a black square, of 0..1023
  int light_adc = 900;
  bool is_inverted = false;                // light reads low
  std::chrono::microseconds rise_time{0};  // time constants of the approach to a new level
  std::chrono::microseconds fall_time{0};
};

struct LevelSample {
  rig::HostTime time;
  int level_adc = 0;
};

// Pure. Not thread-safe.
class Photodiode {
 public:
  explicit Photodiode(const PhotodiodeSettings& settings);

  // The square turns to `brightness_frac` (0..1) at `time`: what is read from then on, until
  // further notice. Of earlier samples those at or after `time` no longer hold.
  std::vector<LevelSample> look(rig::HostTime time, double brightness_frac);
  void set_fall_time(std::chrono::microseconds fall_time) { settings_.fall_time = fall_time; }

 private:
  double level_at(rig::HostTime time) const;  // 0..1

  PhotodiodeSettings settings_;
  rig::HostTime turned_at_{};
  double from_frac_ = 0, to_frac_ = 0;
};

}  // namespace hw_sim
