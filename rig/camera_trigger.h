// The camera as its own trigger box, for rigs that have none (sync modes camera_line and software).
// It stands between the camera and the session's queue and tells of every frame what a box would
// have told: the edge and its one pulse, numbered by the camera's own count of triggers and timed
// by its own clock.
//
//   camera ─► FrameArrived ─► EdgeSeen, PulseEnded, FrameArrived ─► session
//
// The level after the edge is the line's, as the frame says it: a trigger that no change of the
// square made shows the level of before. From a camera that does not say it, and without a
// photodiode, it is what the count implies, which proves nothing: arming happens under a dark
// square, and every change of it is counted. A frame that was lost is told of as FrameDamaged, when
// the next one shows it; whoever listens knows what that means for the count.
#pragma once

#include <cstdint>
#include <mutex>
#include <vector>

#include "rig/camera.h"
#include "rig/event.h"
#include "rig/trigger.h"

namespace rig {

// post() comes from the camera's thread, the rest from the thread that runs the session.
class CameraTrigger final : public Trigger, public EventSink {
 public:
  // `sink` outlives it.
  explicit CameraTrigger(EventSink& sink) : sink_(sink) {}

  // The camera that posts here; it need not be open. Once, before arm().
  void watch(Camera& camera) { camera_ = &camera; }

  const TriggerIdentity& identity() const override { return identity_; }
  Device device() const override { return Device::kCamera; }
  // After the camera was armed. `pulse_widths` are its exposures, which take turns. Errors: those
  // of Camera::read_clock().
  Result<void> arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                   std::uint32_t run_id) override;
  void disarm() noexcept override;
  Result<TriggerCounters> counters() override;

  void post(Event event) override;

 private:
  void account_for(const Frame& frame);
  void tell_of_lost(std::uint64_t up_to_block);

  EventSink& sink_;
  Camera* camera_ = nullptr;  // borrowed
  const TriggerIdentity identity_{};
  std::mutex mutex_;
  bool is_armed_ = false;  // guarded by mutex_, as all below
  std::vector<std::chrono::microseconds> exposures_;
  ClockMap<CameraClock> clock_;
  std::uint64_t last_count_ = 0;
  std::uint64_t last_block_ = 0;
};

}  // namespace rig
