// The comparator between a photodiode and a digital line: high above one level, low below another.
#pragma once

namespace hw_sim {

class Comparator {
 public:
  // Photodiode levels in ADC counts, as a trigger box's thresholds.
  static constexpr int kHigh_adc = 600, kLow_adc = 400;

  // Takes a level; true if the line has changed with it.
  bool look(int level_adc) {
    const bool was_high = is_high_;
    if (level_adc > kHigh_adc) is_high_ = true;
    if (level_adc < kLow_adc) is_high_ = false;
    return is_high_ != was_high;
  }
  bool is_high() const { return is_high_; }

 private:
  bool is_high_ = false;
};

}  // namespace hw_sim
