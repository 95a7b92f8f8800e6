#include "hw_sim/devices/sim_photodiode.h"

#include <cmath>

namespace hw_sim {
namespace {

using std::chrono::microseconds;

// Levels far on either side of any sensible thresholds.
constexpr int kLightAdc = 900;
constexpr int kDarkAdc = 100;
constexpr microseconds kFlashDelay{5000};  // beyond the debounce time
constexpr microseconds kFlashDuration{1000};
constexpr microseconds kBounceDelay{200};  // within the debounce time
constexpr microseconds kBounceDuration{100};
constexpr int kFallSteps = 20;  // four a time constant

}  // namespace

void SimPhotodiode::square(bool is_light, const FlipFaults& faults) {
  is_true_square_light_ = is_light;
  if (is_stuck_ || faults.is_edge_missed) return;
  const bool is_fall = is_square_light_ && !is_light;
  is_square_light_ = is_light;
  if (is_fall && faults.fall_time.count() > 0) return fall_slowly(faults.fall_time);
  read(level_now());
}

int SimPhotodiode::level_now() const {
  if (!is_square_light_) return kDarkAdc;
  return kDarkAdc + static_cast<int>(std::lround(level_frac_ * (kLightAdc - kDarkAdc)));
}

void SimPhotodiode::read(int level_adc) {
  ++level_number_;
  on_level_(level_adc);
}

void SimPhotodiode::fall_slowly(std::chrono::milliseconds time_constant) {
  ++level_number_;
  for (int step = 1; step <= kFallSteps; ++step) {
    const double left_frac = step == kFallSteps ? 0 : std::exp(-step / 4.0);
    const int level_adc =
        kDarkAdc + static_cast<int>(std::lround(left_frac * (kLightAdc - kDarkAdc)));
    timeline_.schedule(timeline_.now() + time_constant * step / 4,
                       [this, level_adc, number = level_number_] {
                         if (number == level_number_) on_level_(level_adc);
                       });
  }
}

void SimPhotodiode::stick(bool is_stuck) {
  is_stuck_ = is_stuck;
  square(is_true_square_light_);
}

void SimPhotodiode::dim(double level_frac) {
  level_frac_ = level_frac;
  read(level_now());
}

void SimPhotodiode::take_faults(FaultSchedule& faults) {
  const rig::HostTime now = timeline_.now();
  if (faults.take(FaultKind::kLightFlash)) disturb(now + kFlashDelay, kFlashDuration);
  if (faults.take(FaultKind::kEdgeBounced)) disturb(now + kBounceDelay, kBounceDuration);
}

// Another light in the room: it sees the opposite of the square for a moment.
void SimPhotodiode::disturb(rig::HostTime start, microseconds duration) {
  timeline_.schedule(start, [this] { read(is_square_light_ ? kDarkAdc : kLightAdc); });
  timeline_.schedule(start + duration, [this] { read(level_now()); });
}

}  // namespace hw_sim
