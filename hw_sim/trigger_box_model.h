// The trigger box without its wires: photodiode level in, pulses and TB1 records out. Pure: time
// comes in as an argument. Used by the in-process trigger and by the usbfs device.
//
//                level > threshold_high: rise; level < threshold_low: fall
//   Disarmed ──ARM──► Waiting ──edge──► Train: delay, pulse, gap, pulse, ... ──last end──► Waiting
//      ▲                   │                      │
//      └──────DISARM───────┴──────────────────────┘
//
// The comparator follows the light at all times. An edge is answered when armed, asked for by
// Config::edges, outside a train and at least the debounce time after any other edge; asked for
// but not answered it is a kIgnoredEdge record; not asked for it is nothing.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "rig/clock.h"
#include "rig/trigger_box_protocol.h"

namespace hw_sim {

struct LinePulse {
  rig::HostTime start;
  std::chrono::microseconds width{0};
  int index = 0;  // in its train
};

struct BoxOutput {
  std::vector<rig::tb1::Record> records;  // for the host, in order
  std::vector<LinePulse> pulses;          // on the camera's trigger line, each at its start
};

// Not thread-safe. What happens has the time that it is told or was due at, not that of the call
// to advance(), so a late thread does not enter the data; only what comes earlier than something
// that has already happened counts as happening right after it.
class TriggerBoxModel {
 public:
  // The box's crystal runs `drift_ppm` fast.
  explicit TriggerBoxModel(rig::HostTime power_up, double drift_ppm = 0);

  // A vendor request of TB1. nullopt: STALL. For IN requests the bytes to return.
  std::optional<std::vector<std::uint8_t>> control(std::uint8_t request, std::uint16_t value,
                                                   const std::vector<std::uint8_t>& data,
                                                   rig::HostTime now);

  // The photodiode's level at `time` in ADC counts 0..1023.
  void light(rig::HostTime time, int level_adc);

  // When something is next due (pulse start, pulse end, heartbeat); nullopt when nothing is.
  std::optional<rig::HostTime> next_due() const;

  // All that happened up to `now`.
  BoxOutput advance(rig::HostTime now);

  // Is there room for records on the way to the host? Without, they are counted and dropped, and
  // the first one with room again is a kOverflow.
  void set_queue_full(bool is_full) { is_queue_full_ = is_full; }

  // The box's own clock at `now`.
  std::uint64_t time_us(rig::HostTime now) const;

  bool is_armed() const { return status_.is_armed; }

 private:
  struct Train {
    std::array<LinePulse, rig::tb1::kPulseLimit> pulses;
    std::size_t pulse_count = 0;
    std::size_t pulse_index = 0;  // the one that is up, or goes up next
    bool is_up = false;
    rig::HostTime due() const;
  };

  bool set_config(const std::vector<std::uint8_t>& data);
  bool arm(std::uint16_t run_id);
  void disarm();
  bool soft_trigger();
  rig::tb1::Levels take_levels();
  void edge(bool is_light);
  void start_train(std::chrono::microseconds delay);
  void step_train();
  void run_due(rig::HostTime time);
  void step_to(rig::HostTime time);
  void record(rig::tb1::RecordType type, std::size_t pulse_index = 0);
  bool wants_edge(bool is_light) const;

  rig::HostTime power_up_;
  double drift_frac_;
  rig::HostTime now_;  // of the latest thing that happened
  rig::HostTime next_heartbeat_;

  std::optional<rig::tb1::Config> config_;
  bool is_light_ = false;  // comparator
  int level_adc_ = 0;
  int minimum_adc_ = 0;  // since the last GET_LEVEL
  int maximum_adc_ = 0;
  std::optional<rig::HostTime> last_edge_;  // answered or not, since arming
  std::optional<Train> train_;

  bool is_queue_full_ = false;
  bool owes_overflow_ = false;
  std::uint32_t next_seq_ = 0;
  rig::tb1::Status status_;  // counters and run id

  BoxOutput output_;
};

}  // namespace hw_sim
