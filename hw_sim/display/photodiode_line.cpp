#include "hw_sim/display/photodiode_line.h"

#include <algorithm>
#include <utility>

namespace hw_sim {
namespace {

constexpr int kDark_adc = 100, kLight_adc = 900;
// A flash in the room while the shutter is open; chatter of an edge.
constexpr std::chrono::microseconds kFlashDelay{5000}, kFlashDuration{1000};
constexpr std::chrono::microseconds kBounceDelay{200}, kBounceDuration{100};

}  // namespace

PhotodiodeLine::PhotodiodeLine(FaultSchedule& faults, OnEdge on_edge)
    : faults_(faults),
      on_edge_(std::move(on_edge)),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

void PhotodiodeLine::light(rig::HostTime time, int level_adc) {
  const std::lock_guard lock(mutex_);
  coming_light_.emplace(time, level_adc);
  has_changed_ = true;
  changed_.notify_all();
}

void PhotodiodeLine::disturb_light(rig::HostTime start, std::chrono::microseconds duration) {
  coming_light_.emplace(start, comparator_.is_high() ? kDark_adc : kLight_adc);
  coming_light_.emplace(start + duration, level_adc_);
}

void PhotodiodeLine::take_faults(rig::HostTime now) {
  if (faults_.take(FaultKind::kLightFlash)) disturb_light(now + kFlashDelay, kFlashDuration);
  if (faults_.take(FaultKind::kEdgeBounced)) disturb_light(now + kBounceDelay, kBounceDuration);
}

void PhotodiodeLine::run(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    const rig::HostTime now = rig::HostClock::now();
    if (!coming_light_.empty() && coming_light_.begin()->first <= now) {
      const auto [time, level_adc] = *coming_light_.begin();
      coming_light_.erase(coming_light_.begin());
      level_adc_ = level_adc;
      if (!comparator_.look(level_adc)) continue;
      lock.unlock();
      const bool has_begun = on_edge_(time, comparator_.is_high());
      lock.lock();
      if (has_begun) take_faults(time);
      continue;
    }
    has_changed_ = false;
    // In the dark there is nothing due; a day is then as good as for ever.
    const rig::HostTime due =
        coming_light_.empty() ? now + std::chrono::hours(24) : coming_light_.begin()->first;
    changed_.wait_until(lock, stop, due, [this] { return has_changed_; });
  }
}

}  // namespace hw_sim
