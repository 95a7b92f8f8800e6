#include "rig/event.h"

#include <utility>

namespace rig {

std::string_view to_string(Device device) {
  switch (device) {
    case Device::kProjector:
      return "projector";
    case Device::kTrigger:
      return "trigger box";
    case Device::kCamera:
      return "camera";
  }
  return "unknown device";
}

void EventQueue::post(Event event) {
  {
    const std::lock_guard lock(mutex_);
    events_.push_back(std::move(event));
  }
  arrived_.notify_one();
}

std::optional<Event> EventQueue::wait(HostTime deadline, const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  arrived_.wait_until(lock, stop, deadline, [this] { return !events_.empty(); });
  if (events_.empty()) return std::nullopt;
  Event event = std::move(events_.front());
  events_.pop_front();
  return event;
}

}  // namespace rig
