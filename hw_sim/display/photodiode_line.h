// The photodiode wired straight to a digital input (sync mode camera_line): a comparator between
// them, and nothing else.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <stop_token>
#include <thread>

#include "hw_sim/comparator.h"
#include "hw_sim/faults/fault_schedule.h"
#include "rig/clock.h"

namespace hw_sim {

// Thread-safe. Starts one thread.
class PhotodiodeLine {
 public:
  // Called when the line goes up or down, from its thread. True if a showing has begun with it.
  using OnEdge = std::function<bool(rig::HostTime, bool is_high)>;

  // `faults` outlives it; those of the light are carried out here.
  PhotodiodeLine(FaultSchedule& faults, OnEdge on_edge);

  // The photodiode's level from `time` on, in ADC counts 0..1023. `time` may be ahead.
  void light(rig::HostTime time, int level_adc);

 private:
  void run(const std::stop_token& stop);
  void take_faults(rig::HostTime now);
  void disturb_light(rig::HostTime start, std::chrono::microseconds duration);

  FaultSchedule& faults_;
  const OnEdge on_edge_;
  std::mutex mutex_;
  std::condition_variable_any changed_;
  bool has_changed_ = false;                        // guarded by mutex_, as all below
  std::multimap<rig::HostTime, int> coming_light_;  // equal times in the order of the calls
  int level_adc_ = 0;
  Comparator comparator_;
  std::jthread thread_;
};

}  // namespace hw_sim
