// The virtual clock of the in-process rig. Time stands still until the session waits; waiting runs
// the devices' scheduled actions one after the other, so a capture takes as long as its arithmetic
// and happens the same way every time.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <stop_token>
#include <utility>

#include "rig/event.h"

namespace hw_sim {

// Not thread-safe: devices and session share one thread.
class Timeline final : public rig::EventSource, public rig::EventSink {
 public:
  // Runs `action` at `when`, or at once if that is past, but never inside this call. Actions of one
  // moment run in the order of scheduling.
  void schedule(rig::HostTime when, std::function<void()> action);

  void post(rig::Event event) override { events_.push_back(std::move(event)); }
  rig::HostTime now() const override { return now_; }
  // Moves time forward through the scheduled actions until one has posted an event, or to
  // `deadline`. On stop time stands still.
  std::optional<rig::Event> wait(rig::HostTime deadline, const std::stop_token& stop) override;

 private:
  using Moment = std::pair<rig::HostTime, std::uint64_t>;  // when, and the how manieth schedule()

  rig::HostTime now_{std::chrono::hours(1)};  // room for pictures shown "before"
  std::uint64_t schedule_count_ = 0;
  std::map<Moment, std::function<void()>> actions_;
  std::deque<rig::Event> events_;
};

}  // namespace hw_sim
