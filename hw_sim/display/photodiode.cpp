#include "hw_sim/display/photodiode.h"

#include <cmath>

namespace hw_sim {
namespace {

// Samples of one approach: at every quarter of the time constant until it is within exp(-5).
constexpr int kStepsPerConstant = 4;
constexpr int kStepCount = 5 * kStepsPerConstant;

}  // namespace

Photodiode::Photodiode(const PhotodiodeSettings& settings) : settings_(settings) {}

double Photodiode::level_at(rig::HostTime time) const {
  const auto constant = to_frac_ > from_frac_ ? settings_.rise_time : settings_.fall_time;
  if (constant.count() == 0 || time < turned_at_) return to_frac_;
  const double elapsed =
      std::chrono::duration<double>(time - turned_at_) / std::chrono::duration<double>(constant);
  return to_frac_ + (from_frac_ - to_frac_) * std::exp(-elapsed);
}

std::vector<LevelSample> Photodiode::look(rig::HostTime time, double brightness_frac) {
  from_frac_ = level_at(time);
  to_frac_ = brightness_frac;
  turned_at_ = time;
  const auto constant = to_frac_ > from_frac_ ? settings_.rise_time : settings_.fall_time;
  const auto to_adc = [this](double level_frac) {
    const double lit_frac = settings_.is_inverted ? 1 - level_frac : level_frac;
    return static_cast<int>(
        std::lround(settings_.dark_adc + lit_frac * (settings_.light_adc - settings_.dark_adc)));
  };
  if (constant.count() == 0) return {{time, to_adc(brightness_frac)}};
  std::vector<LevelSample> samples;
  for (int step = 1; step <= kStepCount; ++step) {
    const rig::HostTime at = time + constant * step / kStepsPerConstant;
    samples.push_back({at, to_adc(step == kStepCount ? brightness_frac : level_at(at))});
  }
  return samples;
}

}  // namespace hw_sim
