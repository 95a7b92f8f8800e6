// The trigger box without its wires: photodiode level in, pulses and TB1 records out. Pure: time
// comes in as an argument. Used by the in-process trigger and by the usbfs device.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "rig/clock.h"
#include "rig/trigger_box_protocol.h"

namespace hw_sim {

struct LinePulse {
  rig::HostTime start;
  std::chrono::microseconds width{0};
};

struct BoxOutput {
  std::vector<rig::tb1::Record> records;  // for the host, in order
  std::vector<LinePulse> pulses;          // on the camera's trigger line, each at its start
};

// Not thread-safe. Times never go back.
class TriggerBoxModel {
 public:
  explicit TriggerBoxModel(rig::HostTime power_up);

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

  // The box's own clock at `now`.
  std::uint64_t time_us(rig::HostTime now) const;

  bool is_armed() const;
};

}  // namespace hw_sim
