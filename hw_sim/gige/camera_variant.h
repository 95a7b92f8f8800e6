// What differs from maker to maker, and what whoever used the simulated camera last has left in it.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace hw_sim {

inline constexpr std::size_t kColourCount = 3;  // red, green, blue

struct CameraVariant {
  bool has_integer_times = false;  // TriggerDelay and LineDebouncerTime; else they are floats
  bool has_line_selector = true;
  std::vector<std::string> fixed_features;    // may be read alone; times and inverters are zero
  std::vector<std::string> refused_features;  // described, but reading them is an error
  // At power-up.
  float gain_db = 0;
  float black_level_dn = 0;  // of the first pixel format, and scaled with the bits of others
  float line_debounce_us = 0;
  std::array<float, kColourCount> balance_ratios{1, 1, 1};
  // The gain falls to the step below; 0: no steps.
  double gain_step_db = 0;
};

}  // namespace hw_sim
