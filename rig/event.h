// Everything that devices tell the session thread, and the one queue it comes through.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string_view>
#include <variant>

#include "rig/clock.h"
#include "rig/fault.h"
#include "rig/frame.h"

namespace rig {

enum class Device { kProjector, kTrigger, kCamera };
std::string_view to_string(Device device);

// The picture of a Projector::show() is in the scan-out: the buffer swap returned at `swapped`.
struct PictureShown {
  std::uint64_t show_id = 0;
  HostTime swapped;
};

// The photodiode saw the sync square change.
struct EdgeSeen {
  std::uint32_t edge_number = 0;  // 1, 2, ... since arming
  bool is_light = false;          // level after the edge
  HostTime time;
};

// The trigger box raised (and lowered) the camera's trigger line once for one bracket.
struct PulseEnded {
  std::uint32_t edge_number = 0;
  int pulse_index = 0;             // bracket, 0 ... n-1
  std::uint32_t pulse_number = 0;  // 1, 2, ... since arming: the camera's expected trigger count
  HostTime started;
  HostTime ended;
};

// An edge that the box did not answer with pulses.
struct EdgeIgnored {
  std::uint32_t edge_number = 0;
  bool is_light = false;
  HostTime time;
};

struct FrameArrived {
  Frame frame;
};

// A block that must not be used; its id is 0 where not even that is known.
struct FrameDamaged {
  std::uint64_t block_id = 0;
  Error error;
};

struct DeviceFault {
  Device device = Device::kCamera;
  Error error;
};

// Opening a device anew has come to an end, good or bad: Reopener::finish() knows which.
struct DeviceOpened {
  Device device = Device::kCamera;
};

using Event = std::variant<PictureShown, EdgeSeen, PulseEnded, EdgeIgnored, FrameArrived,
                           FrameDamaged, DeviceFault, DeviceOpened>;

// Where devices put events. Thread-safe; never blocks.
class EventSink {
 public:
  virtual ~EventSink() = default;
  virtual void post(Event event) = 0;
};

// Where the session thread waits: its only wait. Real rigs: EventQueue. In-process simulation: a
// virtual timeline whose wait() moves time forward (hw_sim/devices/timeline.h).
class EventSource {
 public:
  virtual ~EventSource() = default;
  virtual HostTime now() const = 0;
  // The next event; nullopt at `deadline` or on stop. Events posted before are delivered first, in
  // order.
  virtual std::optional<Event> wait(HostTime deadline, const std::stop_token& stop) = 0;
};

// Unbounded in type, bounded in use: a capture posts a handful of events a frame, and
// frames are bounded by the camera's buffers. post() from any thread, wait() from one.
class EventQueue final : public EventSink, public EventSource {
 public:
  void post(Event event) override;
  HostTime now() const override { return HostClock::now(); }
  std::optional<Event> wait(HostTime deadline, const std::stop_token& stop) override;

 private:
  std::mutex mutex_;
  std::condition_variable_any arrived_;
  std::deque<Event> events_;  // guarded by mutex_
};

}  // namespace rig
