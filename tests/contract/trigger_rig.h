// A trigger that tests can shine light on: what tests/contract/trigger_contract.h runs on.
#pragma once

#include <chrono>
#include <memory>
#include <optional>

#include "rig/event.h"
#include "rig/trigger.h"

namespace trigger_contract {

// What the trigger under test is to be opened with; the serial is the maker's.
inline rig::TriggerSettings settings() {
  return {.delay_rise = std::chrono::microseconds(1000),
          .delay_fall = std::chrono::microseconds(3000),
          .gap = std::chrono::microseconds(5000),
          .debounce = std::chrono::microseconds(2000),
          .threshold_high = 600,
          .threshold_low = 400};
}

constexpr int kDark_adc = 100;
constexpr int kLight_adc = 900;

// A trigger with a lamp in front of its photodiode, which is dark at first.
class TriggerRig {
 public:
  virtual ~TriggerRig() = default;
  virtual rig::Trigger& trigger() = 0;
  virtual rig::HostTime now() = 0;
  // The photodiode's level from `time`, which is not past, until the next call.
  virtual void light(rig::HostTime time, int level_adc) = 0;
  // The next event; nullopt at `deadline`. Simulated time may pass nowhere else.
  virtual std::optional<rig::Event> wait(rig::HostTime deadline) = 0;
};

using MakeTriggerRig = std::unique_ptr<TriggerRig> (*)();

}  // namespace trigger_contract
