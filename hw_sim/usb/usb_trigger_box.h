// The simulated trigger box at the end of its wire: a TB1 device on the USB testbed. Light goes
// in, records go out to whoever has the device open, pulses go to a callback.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/trigger_box_model.h"
#include "hw_sim/usb/usb_testbed.h"
#include "hw_sim/usb/usbfs_device.h"
#include "rig/clock.h"

namespace hw_sim {

struct UsbTriggerBoxOptions {
  std::uint16_t vendor_id = 0x1209;
  std::uint16_t product_id = 0x0001;
  std::string serial = "TB-SIM-0001";
  UsbAddress address{};
  double drift_ppm = 0;             // of the box's crystal
  FaultSchedule* faults = nullptr;  // outlives the box; told how far a capture is
};

// Thread-safe. Clients close the device before the box is destroyed.
class UsbTriggerBox {
 public:
  // Called when the camera's trigger line goes up, from the box's thread, without a lock held. May
  // call light().
  using OnPulse = std::function<void(LinePulse)>;

  UsbTriggerBox(UsbTestbed& testbed, UsbTriggerBoxOptions options, OnPulse on_pulse);
  ~UsbTriggerBox();
  UsbTriggerBox(const UsbTriggerBox&) = delete;
  UsbTriggerBox& operator=(const UsbTriggerBox&) = delete;

  // The photodiode's level from `time` on, in ADC counts 0..1023. `time` may be ahead; one that is
  // late keeps its value as far as TriggerBoxModel's rule allows.
  void light(rig::HostTime time, int level_adc);

  // Faults.
  void unplug();  // the cable is out: the box loses its power, too
  void replug();  // in again: a new address, a box that remembers nothing
  void stall_in();
  void drop_next_record();                // a gap in the sequence numbers
  void set_mute(bool is_mute);            // alive, but sends nothing
  void set_control_naked(bool is_naked);  // does not answer vendor requests
  void corrupt_next_config();             // GET_CONFIG returns something else than was set
  void refuse_claims(bool is_refusing);

 private:
  UsbReply control(const UsbSetup& setup, const std::vector<std::uint8_t>& data);
  void plug_in();  // with mutex_ held, as the following
  void see_light_until(rig::HostTime now);
  void start_train(rig::HostTime now);
  void disturb_light(rig::HostTime start, std::chrono::microseconds duration);
  void send(std::vector<rig::tb1::Record> records);
  rig::HostTime next_due() const;

  void run(const std::stop_token& stop);

  UsbTestbed& testbed_;
  const UsbTriggerBoxOptions options_;
  const OnPulse on_pulse_;

  std::mutex mutex_;  // taken before a device's own
  std::condition_variable_any changed_;
  bool has_changed_ = false;  // guarded by mutex_, as all below
  UsbAddress next_address_;
  TriggerBoxModel model_;
  // The last is the one that is plugged in, or was. The others are unplugged, and stay because a
  // client may still have them open.
  std::vector<std::unique_ptr<UsbfsDevice>> devices_;
  std::multimap<rig::HostTime, int> coming_light_;  // equal times in the order of the calls
  int level_adc_ = 0;
  bool is_plugged_in_ = false;
  bool is_mute_ = false;
  rig::HostTime silent_until_;
  bool is_control_naked_ = false;
  bool drops_next_record_ = false;
  bool corrupts_next_config_ = false;

  std::jthread thread_;
};

}  // namespace hw_sim
