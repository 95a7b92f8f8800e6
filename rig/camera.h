// A triggered area camera, as capture sees it. The real one speaks GigE Vision
// (rig/devices/aravis_camera.h), hw_sim has another (hw_sim/devices/sim_camera.h); both pass
// tests/contract/camera_contract.h.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "rig/clock.h"
#include "rig/fault.h"

namespace rig {

// How one pulse becomes one exposure of its bracket.
enum class Bracketing {
  kSequencer,    // GenICam sequencer: the camera steps through the exposures, one per trigger
  kTriggerWidth  // ExposureMode TriggerWidth: the pulse's width is the exposure
};

// Which change of the trigger line is a trigger: the box's pulse rises; a photodiode on the line
// itself (sync mode camera_line) does both in turn.
enum class TriggerEdge { kRising, kAny };

// The trigger line that is none: trigger_software() is the trigger.
inline constexpr std::string_view kSoftwareTrigger = "Software";

// Set once at opening, from the rig file.
struct CameraSettings {
  std::string address = "192.168.0.10";  // IPv4 address, or "Vendor-Model-Serial"
  std::string serial;                    // verified when not empty
  std::string pixel_format = "BayerRG12";
  int width_px = 0;
  int height_px = 0;
  int offset_x_px = 0;
  int offset_y_px = 0;
  int packet_size_bytes = 0;  // 0: negotiated, at most the interface's MTU
  Bracketing bracketing = Bracketing::kSequencer;
  std::string trigger_line = "Line1";
  TriggerEdge trigger_edge = TriggerEdge::kRising;
  // How long the line must keep its level for an edge to count, where it takes edges of both kinds:
  // a photodiode's comparator bounces. Each edge is as much later. Half a millisecond is longer
  // than that, and little against a refresh.
  std::chrono::microseconds line_debounce{500};
};

struct CameraIdentity {
  std::string vendor, model, serial, firmware;
  std::string note = {};  // what it does without, one sentence with the remedy; empty: nothing
  // Its frames say which level the trigger line had when they began (Frame::is_line_high).
  bool tells_line_level = false;
};

// Since arm(). -1 where the camera has no such counter.
struct CameraCounters {
  std::int64_t trigger_count = -1;         // pulses seen on the line
  std::int64_t missed_trigger_count = -1;  // pulses that came while it was busy
  std::int64_t delivered_frame_count = 0;
  std::int64_t damaged_frame_count = 0;
  std::int64_t resent_packet_count = 0;
};

// The camera's clock read `device` when the host's read `host`, give or take `uncertainty`.
struct CameraClockSample {
  CameraClock::time_point device;
  HostTime host;
  std::chrono::nanoseconds uncertainty{0};
};

// Posts FrameArrived, FrameDamaged and DeviceFault{kCamera} to the EventSink given at opening, from
// its own thread. Not thread-safe: the calls below come from the thread that runs the session. The
// sink outlives the camera.
class Camera {
 public:
  virtual ~Camera() = default;

  virtual const CameraIdentity& identity() const = 0;

  // Idle -> Armed: from here every pulse on the line is one frame, its exposures cycling through
  // `bracket_exposures` (shortest first) from the first. `frame_count` buffers are ready before it
  // returns. Every setting is read back. Block ids and trigger counts start at 1. Errors: kBusy if
  // armed; kOutOfRange if it cannot expose so long; kReadBackMismatch; kUnsupported (also:
  // kSequencer on a camera whose frames do not tell their exposure); kDeviceLost.
  virtual Result<void> arm(const std::vector<std::chrono::microseconds>& bracket_exposures,
                           int frame_count) = 0;

  // Any state -> Idle; frames still on the way are discarded, leases stay valid. Safe to call
  // twice.
  virtual void disarm() noexcept = 0;

  // Errors: kDeviceLost.
  virtual Result<CameraCounters> counters() = 0;

  // The clock that frames' timestamps are of. Errors: kUnsupported (it cannot be read);
  // kDeviceLost.
  virtual Result<CameraClockSample> read_clock() = 0;

  // Armed: one exposure, now. Errors: kBusy if idle; kUnsupported unless the trigger line is
  // "Software"; kDeviceLost.
  virtual Result<void> trigger_software() = 0;
};

}  // namespace rig
