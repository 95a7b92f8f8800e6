// The production driver on a simulated trigger box, in one process.
#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "hw_sim/usb/usb_testbed.h"
#include "hw_sim/usb/usb_trigger_box.h"
#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"
#include "tests/contract/trigger_rig.h"

class WireTriggerRig final : public trigger_contract::TriggerRig {
 public:
  // nullptr without umockdev's preload library.
  static std::unique_ptr<WireTriggerRig> plug_in(const hw_sim::UsbTriggerBoxOptions& options = {}) {
    auto testbed = hw_sim::UsbTestbed::open();
    if (!testbed) return nullptr;
    return std::unique_ptr<WireTriggerRig>(new WireTriggerRig(*std::move(testbed), options));
  }

  rig::Result<void> open(const rig::TriggerSettings& settings = trigger_contract::settings()) {
    auto trigger = rig::LibusbTrigger::open(settings, events_);
    if (!trigger) return tl::unexpected(trigger.error());
    trigger_ = *std::move(trigger);
    return {};
  }
  void close() { trigger_.reset(); }

  hw_sim::UsbTestbed& testbed() { return *testbed_; }
  hw_sim::UsbTriggerBox& box() { return box_; }
  rig::LibusbTrigger& usb_trigger() { return *trigger_; }

  rig::Trigger& trigger() override { return *trigger_; }
  rig::HostTime now() override { return rig::HostClock::now(); }
  void light(rig::HostTime time, int level_adc) override { box_.light(time, level_adc); }
  std::optional<rig::Event> wait(rig::HostTime deadline) override {
    return events_.wait(deadline, {});
  }

  // What reached the camera's line, once it is `count` pulses or 20 s have passed.
  std::vector<hw_sim::LinePulse> line_pulses(std::size_t count) {
    std::unique_lock lock(mutex_);
    pulsed_.wait_for(lock, std::chrono::seconds(20),
                     [this, count] { return line_pulses_.size() >= count; });
    return line_pulses_;
  }

 private:
  WireTriggerRig(std::unique_ptr<hw_sim::UsbTestbed> testbed,
                 const hw_sim::UsbTriggerBoxOptions& options)
      : testbed_(std::move(testbed)),
        box_(*testbed_, options, [this](hw_sim::LinePulse pulse) { take_pulse(pulse); }) {}

  void take_pulse(hw_sim::LinePulse pulse) {
    {
      const std::lock_guard lock(mutex_);
      line_pulses_.push_back(pulse);
    }
    pulsed_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable pulsed_;
  std::vector<hw_sim::LinePulse> line_pulses_;  // guarded by mutex_
  // Destroyed upwards: the client goes before the device, that before the testbed.
  std::unique_ptr<hw_sim::UsbTestbed> testbed_;
  hw_sim::UsbTriggerBox box_;
  rig::EventQueue events_;
  std::unique_ptr<rig::LibusbTrigger> trigger_;
};
