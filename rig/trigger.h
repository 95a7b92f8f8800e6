// The trigger box: photodiode in, camera pulses out, as capture sees it. The real one speaks TB1
// over libusb (rig/devices/libusb_trigger.h), hw_sim has another; both pass
// tests/contract/trigger_contract.h.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "rig/event.h"
#include "rig/fault.h"

namespace rig {

struct TriggerSettings {
  std::uint16_t vendor_id = 0x1209;
  std::uint16_t product_id = 0x0001;
  std::string serial{};                     // empty: the only one plugged in
  std::chrono::microseconds delay_rise{0};  // light edge to first pulse
  std::chrono::microseconds delay_fall{0};
  std::chrono::microseconds gap{
      5000};  // end of one pulse to the start of the next: at least the camera's readout
  std::chrono::microseconds debounce{2000};  // edges this soon after another are ignored
  std::uint16_t threshold_high = 600;        // ADC counts, 0..1023
  std::uint16_t threshold_low = 400;
};

struct TriggerIdentity {
  std::string serial;
  int protocol_version = 0;
  int firmware_version = 0;
};

struct TriggerCounters {
  std::uint32_t edge_count = 0;
  std::uint32_t pulse_count = 0;
  std::uint32_t ignored_edge_count = 0;
  std::uint32_t dropped_record_count = 0;
};

// Posts EdgeSeen, PulseEnded, EdgeIgnored and DeviceFault{kTrigger} to the EventSink given at
// opening, from its own thread, times on the host's clock. Not thread-safe: called from the thread
// that runs the session.
class Trigger {
 public:
  virtual ~Trigger() = default;

  virtual const TriggerIdentity& identity() const = 0;

  // What is lost if arm() says so: the camera, where it is its own trigger box.
  virtual Device device() const { return Device::kTrigger; }

  // Idle -> Armed: each edge of the photodiode is answered with one pulse per element of
  // `pulse_widths`. The configuration is written, read back and compared; counters restart at 1
  // under `run_id`. Errors: kBusy if armed; kOutOfRange (1 to 8 pulses); kReadBackMismatch;
  // kDeviceLost.
  virtual Result<void> arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                           std::uint32_t run_id) = 0;

  // Any state -> Idle; no pulse starts afterwards. Safe to call twice.
  virtual void disarm() noexcept = 0;

  // Errors: kDeviceLost, kTimeout.
  virtual Result<TriggerCounters> counters() = 0;
};

}  // namespace rig
