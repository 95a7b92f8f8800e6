// That a camera is lost, told once. Internal to the Aravis adapter.
#pragma once

#include <atomic>
#include <mutex>
#include <string>

#include "rig/event.h"

namespace rig {

// Never tells a sink whose camera is gone. Thread-safe: Aravis' heartbeat thread reports here.
class LossLatch {
 public:
  explicit LossLatch(EventSink& sink) : sink_(&sink) {}
  void report(const std::string& cause);
  void close();
  bool is_lost() const { return is_lost_; }

 private:
  std::mutex mutex_;
  EventSink* sink_;  // guarded by mutex_
  std::atomic<bool> is_lost_{false};
};

}  // namespace rig
