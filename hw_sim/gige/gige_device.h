// A GigE Vision camera of our own at the far end of the wire: GVCP and GVSP on a loopback address,
// a trigger line, a sequencer, chunks, and faults on request. It shares no code with the client.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/gige/camera_variant.h"
#include "hw_sim/gige/faults.h"
#include "hw_sim/light.h"
#include "hw_sim/world.h"
#include "rig/clock.h"
#include "rig/fault.h"

namespace hw_sim {

struct GigeDeviceOptions {
  std::string address = "127.0.0.1";  // any 127.a.b.c; the port, 3956, is fixed by the standard
  std::string serial = "SIM0001";
  std::vector<std::string> pixel_formats = {"BayerRG12"};  // the first is the default
  double link_rate_bit_per_s = 1e9;                        // 0: unpaced
  std::chrono::microseconds readout{500};
  bool has_64_bit_block_ids = false;
  std::chrono::nanoseconds clock_offset = std::chrono::hours(1);  // reading at start
  double clock_drift_ppm = 0;
  // How late the light time line may still learn what was shown (a grabbed screen); an exposure is
  // cut from it that much after its end.
  std::chrono::microseconds light_latency{0};
  FaultSchedule* faults = nullptr;  // outlives the device
  // In a rig without a trigger box: it tells `faults` how far a capture is.
  bool is_the_trigger = false;
  bool has_any_edge = true;     // TriggerActivation AnyEdge
  bool has_debouncer = true;    // LineDebouncerTime
  bool has_line_status = true;  // chunk LineStatusAll
  CameraVariant variant;
};

struct GigeDeviceCounters {
  std::uint64_t trigger_count = 0;  // since AcquisitionStart
  std::uint64_t missed_trigger_count = 0;
  std::uint64_t sent_frame_count = 0;  // since start(), as all below
  std::uint64_t sent_packet_count = 0;
  std::uint64_t resent_packet_count = 0;
  std::uint64_t lost_packet_count = 0;  // by a fault
};

// Thread-safe. Starts three threads: control (GVCP), exposure, sender (GVSP). The sensor is as
// large as the world's frame.
class GigeDevice {
 public:
  // `world` and `light` outlive the device. Errors: kConfiguration (unknown pixel format, or one
  // that does not fit the world's channels), kNotFound (address taken or not bindable).
  static rig::Result<std::unique_ptr<GigeDevice>> start(const GigeDeviceOptions& options,
                                                        const World& world,
                                                        const LightTimeline& light);
  ~GigeDevice();
  GigeDevice(const GigeDevice&) = delete;
  GigeDevice& operator=(const GigeDevice&) = delete;

  // The hardware line, Line1: a pulse of `width` that rises at `start`. Never blocks for long.
  void pulse(rig::HostTime start, std::chrono::microseconds width);

  // The hardware line, as a photodiode drives it: it goes up or down at `time`. True if that began
  // a showing: the first exposure of a sequencer's round.
  bool line(rig::HostTime time, bool is_high);

  GigeFaults& faults();
  GigeDeviceCounters counters() const;
  float line_debounce_us() const;  // LineDebouncerTime, as it was written
  float gain_db() const;
  float black_level_dn() const;
  float balance_ratio(std::size_t colour) const;  // of red, green, blue

 private:
  class Impl;
  explicit GigeDevice(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace hw_sim
