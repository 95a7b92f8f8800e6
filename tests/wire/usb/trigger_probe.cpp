// A program like ssrig as far as USB goes: the production driver, nothing of the simulator, no
// preload library of its own. Arms the box and prints a line per event until it has seen the given
// number of pulses (exit 0), a fault (3), or nothing for 20 s (1).
//
//   trigger_probe PULSE_COUNT

#include <chrono>
#include <cstdlib>
#include <iostream>
#include <string>
#include <variant>

#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"

int main(int argument_count, char** arguments) {
  if (argument_count != 2) return 2;
  const int wanted_pulse_count = std::atoi(arguments[1]);
  rig::EventQueue events;
  const auto trigger = rig::LibusbTrigger::open({}, events);
  if (!trigger) {
    std::cout << "fault " << rig::to_string(trigger.error().fault) << std::endl;
    return 3;
  }
  const auto armed = (*trigger)->arm({std::chrono::milliseconds(1)}, 1);
  if (!armed) {
    std::cout << "fault " << rig::to_string(armed.error().fault) << std::endl;
    return 3;
  }
  std::cout << "armed " << (*trigger)->identity().serial << std::endl;
  for (int pulse_count = 0; pulse_count < wanted_pulse_count;) {
    const auto event = events.wait(events.now() + std::chrono::seconds(20), {});
    if (!event) return 1;
    if (const auto* fault = std::get_if<rig::DeviceFault>(&*event)) {
      std::cout << "fault " << rig::to_string(fault->error.fault) << std::endl;
      return 3;
    }
    if (const auto* pulse = std::get_if<rig::PulseEnded>(&*event)) {
      ++pulse_count;
      std::cout << "pulse " << pulse->pulse_number << " of edge " << pulse->edge_number
                << std::endl;
    }
  }
  return 0;
}
