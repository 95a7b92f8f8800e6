// Everything a rig file names, simulated at the far end of its wires: the projector's monitor, the
// trigger box on USB, the camera on Ethernet, and light between them.
//
//   product ─► X screen ─► ScreenGrabber ─► LightTimeline ─► World ─► GigeDevice ─► product
//                               └─► photodiode ─► UsbTriggerBox ─► pulses ─┘
//                                                      └─► product
// In sync mode camera_line the photodiode drives the camera's line, in software nothing does.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>

#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/world.h"
#include "rig/clock.h"
#include "rig/fault.h"
#include "rig/rig_file.h"

namespace hw_sim {

struct VirtualRigOptions {
  bool has_line_status = true;  // the camera's chunk LineStatusAll
};

// Not thread-safe. Its clients end before it does.
class VirtualRig {
 public:
  // The devices have the addresses and serial numbers of the rig file; `world` and `faults` outlive
  // the rig. Needs the umockdev preload library in this program. Errors: those of its parts.
  static rig::Result<std::unique_ptr<VirtualRig>> start(const rig::RigFile& rig, const World& world,
                                                        FaultSchedule& faults,
                                                        const VirtualRigOptions& options = {});
  ~VirtualRig();

  // What a program needs in its environment to find the devices.
  std::map<std::string, std::string> child_environment() const;

 private:
  struct Parts;
  static std::function<void(rig::HostTime, int)> wire_photodiode(const rig::RigFile& rig,
                                                                 FaultSchedule& faults,
                                                                 Parts& parts);
  explicit VirtualRig(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

// The GLX shim: beside this program in a build folder, in lib/ssrig when installed. Errors:
// kNotFound with the places that were looked at.
rig::Result<std::string> find_glx_shim();

}  // namespace hw_sim
