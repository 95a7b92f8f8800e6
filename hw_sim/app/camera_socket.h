// Where the simulated camera is plugged in: it can lose its power and start anew while pulses come.
#pragma once

#include <functional>
#include <memory>
#include <mutex>

#include "hw_sim/gige/gige_device.h"

namespace hw_sim {

// Thread-safe.
class CameraSocket {
 public:
  using Start = std::function<rig::Result<std::unique_ptr<GigeDevice>>()>;
  explicit CameraSocket(Start start) : start_(std::move(start)) {}

  // Errors: those of GigeDevice::start().
  rig::Result<void> power_on() {
    const std::lock_guard lock(mutex_);
    if (device_) return {};
    auto device = start_();
    if (!device) return tl::unexpected(device.error());
    device_ = std::move(*device);
    device_->line(rig::HostClock::now(), is_line_high_);  // no trigger to a camera at rest
    return {};
  }
  void power_off() {
    const std::lock_guard lock(mutex_);
    device_.reset();
  }
  void pulse(rig::HostTime start, std::chrono::microseconds width) {
    const std::lock_guard lock(mutex_);
    if (device_) device_->pulse(start, width);
  }
  bool line(rig::HostTime time, bool is_high) {
    const std::lock_guard lock(mutex_);
    is_line_high_ = is_high;
    return device_ && device_->line(time, is_high);
  }
  // Nothing is changed while the power is off.
  void change(const std::function<void(GigeFaults&)>& change) {
    const std::lock_guard lock(mutex_);
    if (device_) change(device_->faults());
  }

 private:
  const Start start_;
  std::mutex mutex_;
  std::unique_ptr<GigeDevice> device_;  // guarded by mutex_
  bool is_line_high_ = false;           // guarded by mutex_
};

}  // namespace hw_sim
