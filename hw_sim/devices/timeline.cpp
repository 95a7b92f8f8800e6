#include "hw_sim/devices/timeline.h"

#include <algorithm>

namespace hw_sim {

void Timeline::schedule(rig::HostTime when, std::function<void()> action) {
  actions_.emplace(Moment{std::max(when, now_), schedule_count_++}, std::move(action));
}

std::optional<rig::Event> Timeline::wait(rig::HostTime deadline, const std::stop_token& stop) {
  while (events_.empty() && !stop.stop_requested()) {
    const auto next = actions_.begin();
    if (next == actions_.end() || next->first.first > deadline) {
      now_ = std::max(now_, deadline);
      return std::nullopt;
    }
    now_ = next->first.first;
    const std::function<void()> action = std::move(next->second);
    actions_.erase(next);
    action();
  }
  if (events_.empty()) return std::nullopt;
  rig::Event event = std::move(events_.front());
  events_.pop_front();
  return event;
}

}  // namespace hw_sim
