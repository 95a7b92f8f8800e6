// Opening a lost device anew while a capture waits for it, and the stand-ins that make this
// possible without anybody's reference going stale.
#pragma once

#include <memory>
#include <optional>
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
  // Lets go of the device and opens it as at the start, every setting verified. Returns at once,
  // for either takes seconds of a dead device, which is closed meanwhile. DeviceOpened follows
  // when that is over, behind all that the old device had to say. If it is under way already, there
  // is one DeviceOpened for both.
  virtual void reopen(Device device) = 0;
  // What reopen() came to: the new device is in its place, or why not, as the device's own open()
  // says. nullopt: it is under way, or was asked before.
  virtual std::optional<Result<void>> finish(Device device) = 0;
};

// A camera that can be closed and opened; in between it is lost.
class ReplaceableCamera final : public Camera {
 public:
  explicit ReplaceableCamera(std::unique_ptr<Camera> camera) { set(std::move(camera)); }

  void set(std::unique_ptr<Camera> camera) {
    camera_ = std::move(camera);
    if (camera_) identity_ = camera_->identity();
  }
  std::unique_ptr<Camera> take() { return std::move(camera_); }  // closed from now on
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
  std::unique_ptr<Trigger> take() { return std::move(trigger_); }  // closed from now on
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
