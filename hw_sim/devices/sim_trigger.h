// The trigger box of the in-process rig: the box's model, without a wire between.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "hw_sim/devices/timeline.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/trigger_box_model.h"
#include "rig/clock.h"
#include "rig/trigger.h"
#include "rig/trigger_box_protocol.h"

namespace hw_sim {

// Not thread-safe: lives on its Timeline's thread.
class SimTrigger final : public rig::Trigger {
 public:
  // Called at each pulse's start: the camera's trigger line.
  using OnPulse = std::function<void(const LinePulse&)>;

  SimTrigger(rig::TriggerSettings settings, FaultSchedule& faults, Timeline& timeline,
             OnPulse on_pulse);

  const rig::TriggerIdentity& identity() const override { return identity_; }
  rig::Result<void> arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                        std::uint32_t run_id) override;
  void disarm() noexcept override;
  rig::Result<rig::TriggerCounters> counters() override;

  // The photodiode's level now, in ADC counts 0..1023.
  void photodiode(int level_adc);

  // Faults that last.
  void silence_until(rig::HostTime end);
  void unplug();  // the box loses its power, too
  void plug_in();
  // What a driver does to a box that it lost. Errors: kNotFound.
  rig::Result<void> open_again();
  // Those that happen when a train starts, or while idle.
  void take_train_faults();

 private:
  std::optional<std::vector<std::uint8_t>> request(rig::tb1::Request request,
                                                   std::uint16_t value = 0,
                                                   const std::vector<std::uint8_t>& data = {});
  void catch_up();  // takes what the box has done, and comes back when something is next due
  void hear(const rig::tb1::Record& record);

  const rig::TriggerSettings settings_;
  FaultSchedule& faults_;
  Timeline& timeline_;
  const OnPulse on_pulse_;
  rig::TriggerIdentity identity_{"SIM", rig::tb1::kProtocolVersion, 0};
  TriggerBoxModel box_;
  rig::ClockMap<rig::BoxClock> clock_;
  std::optional<rig::tb1::RecordReader> reader_;  // while armed
  std::uint64_t wake_up_number_ = 0;              // of the latest: earlier ones are void
  int level_adc_ = 0;                             // of the photodiode
  bool drops_next_record_ = false;
  bool is_plugged_in_ = true;
  rig::HostTime silent_until_;
  bool is_lost_ = false;
};

}  // namespace hw_sim
