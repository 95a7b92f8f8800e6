// Opening a lost device anew while a capture waits for it, and the stand-ins that make this
// possible without anybody's reference going stale.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "rig/camera.h"
#include "rig/event.h"
#include "rig/trigger.h"

namespace rig {

// Not thread-safe: called from the thread that runs the session. What others hold of the devices
// stays valid throughout.
class Reopener {
 public:
  virtual ~Reopener() = default;
  // Lets go of the device; of a dead camera that takes seconds. Nothing is posted by it afterwards.
  virtual void close(Device device) = 0;
  // As at the start, every setting verified. Errors: those of the device's own open().
  virtual Result<void> open(Device device) = 0;
};

// A camera that can be closed and opened; in between it is lost.
class ReplaceableCamera final : public Camera {
 public:
  explicit ReplaceableCamera(std::unique_ptr<Camera> camera) { set(std::move(camera)); }

  void set(std::unique_ptr<Camera> camera) {
    camera_ = std::move(camera);
    if (camera_) identity_ = camera_->identity();
  }
  const CameraIdentity& identity() const override { return identity_; }
  Result<void> arm(const std::vector<std::chrono::microseconds>& bracket_exposures,
                   int frame_count) override {
    if (!camera_) return failure(Fault::kDeviceLost, "the camera is closed");
    return camera_->arm(bracket_exposures, frame_count);
  }
  void disarm() noexcept override {
    if (camera_) camera_->disarm();
  }
  Result<CameraCounters> counters() override {
    if (!camera_) return failure(Fault::kDeviceLost, "the camera is closed");
    return camera_->counters();
  }
  Result<CameraClockSample> read_clock() override {
    if (!camera_) return failure(Fault::kDeviceLost, "the camera is closed");
    return camera_->read_clock();
  }
  Result<void> trigger_software() override {
    if (!camera_) return failure(Fault::kDeviceLost, "the camera is closed");
    return camera_->trigger_software();
  }

 private:
  std::unique_ptr<Camera> camera_;  // nullptr: closed
  CameraIdentity identity_;
};

// The same of a trigger box.
class ReplaceableTrigger final : public Trigger {
 public:
  explicit ReplaceableTrigger(std::unique_ptr<Trigger> trigger) { set(std::move(trigger)); }

  void set(std::unique_ptr<Trigger> trigger) {
    trigger_ = std::move(trigger);
    if (trigger_) identity_ = trigger_->identity();
  }
  const TriggerIdentity& identity() const override { return identity_; }
  Result<void> arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                   std::uint32_t run_id) override {
    if (!trigger_) return failure(Fault::kDeviceLost, "the trigger box is closed");
    return trigger_->arm(pulse_widths, run_id);
  }
  void disarm() noexcept override {
    if (trigger_) trigger_->disarm();
  }
  Result<TriggerCounters> counters() override {
    if (!trigger_) return failure(Fault::kDeviceLost, "the trigger box is closed");
    return trigger_->counters();
  }

 private:
  std::unique_ptr<Trigger> trigger_;  // nullptr: closed
  TriggerIdentity identity_;
};

}  // namespace rig
