// The hand on the cables of the virtual rig: carries out what a plan of faults has for whole
// devices, and puts things right again when their time is over.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <stop_token>
#include <thread>

#include "hw_sim/app/camera_socket.h"
#include "hw_sim/display/screen_grabber.h"
#include "hw_sim/display/virtual_screen.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/usb/usb_trigger_box.h"
#include "rig/clock.h"

namespace hw_sim {

// A count that the GLX shim in another process takes from. Thread-safe.
class SharedCount {
 public:
  explicit SharedCount(const std::filesystem::path& file);
  ~SharedCount();
  SharedCount(const SharedCount&) = delete;
  SharedCount& operator=(const SharedCount&) = delete;
  void add_one();

 private:
  std::atomic<std::int32_t>* count_ = nullptr;  // nullptr: the file cannot be made
};

// Starts one thread.
class Saboteur {
 public:
  struct Victims {
    CameraSocket& camera;
    UsbTriggerBox* box;  // nullptr: the rig has none
    VirtualScreen& screen;
    ScreenGrabber& grabber;
    SharedCount& skipped_blanks;
  };
  // All outlive it.
  Saboteur(FaultSchedule& faults, Victims victims);

 private:
  void run(const std::stop_token& stop);
  void act();
  void act_at_rest();
  void undo_after(std::chrono::milliseconds duration, std::function<void()> undo);
  void undo_what_is_over();

  FaultSchedule& faults_;
  Victims victims_;
  std::multimap<rig::HostTime, std::function<void()>> undos_;  // of the thread, by their time
  std::jthread thread_;
};

}  // namespace hw_sim
