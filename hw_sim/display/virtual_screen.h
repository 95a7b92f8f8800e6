// An X server without a graphics card: Xorg with the dummy driver and two monitors, the operator's
// (DUMMY0, 1920 x 1080) and right of it the projector (DUMMY1).
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "hw_sim/display/child_process.h"
#include "rig/fault.h"

namespace hw_sim {

struct VirtualScreenSettings {
  int projector_width_px = 1024;
  int projector_height_px = 768;
  double refresh_hz = 60;
};

// Runs as root and as an ordinary user, beside others, each on a free display. Not thread-safe.
class VirtualScreen {
 public:
  static constexpr const char* kProjectorOutput = "DUMMY1";

  // Returns when clients can connect. Errors: kNotFound with the package that is missing, or with
  // the last lines of the server's log.
  static rig::Result<std::unique_ptr<VirtualScreen>> start(const VirtualScreenSettings& settings);
  ~VirtualScreen();  // ends the server; its clients should have gone before
  VirtualScreen(const VirtualScreen&) = delete;
  VirtualScreen& operator=(const VirtualScreen&) = delete;

  const std::string& display() const { return display_; }  // ":3", for DISPLAY

  // What a hand on the cable or another program does to the projector's monitor. Errors:
  // kUnsupported if the server refuses.
  rig::Result<void> unplug_projector();
  rig::Result<void> plug_projector_in();
  rig::Result<void> set_projector_gamma(double exponent);  // 1 is identity
  rig::Result<void> halve_projector_rate();                // another mode of the same size
  rig::Result<void> restore_projector_rate();

  // Ends the server at once, as a crash does.
  void crash();
  // It stands still and answers nobody, as with a graphics card that hangs. Not for good: the end
  // of this object ends it.
  void freeze();

 private:
  VirtualScreen() = default;
  rig::Result<void> set_projector_mode(const std::string& mode_name);

  VirtualScreenSettings settings_;
  std::filesystem::path folder_;  // configuration and log; removed at the end
  std::string display_;
  std::unique_ptr<ChildProcess> server_;
};

}  // namespace hw_sim
