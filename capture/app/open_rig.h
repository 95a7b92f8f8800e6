// The real devices of a rig, opened together.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/runner.h"
#include "rig/devices/aravis_camera.h"
#include "rig/devices/glfw_projector.h"
#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"
#include "rig/rig_file.h"

namespace capture {

// Made and destroyed on the main thread (GLFW's rule); devices() is for the session thread.
class OpenRig {
 public:
  // Tries every device, so that all that is missing is known at once: one sentence each in
  // `problems`, and then nullptr. But a rig that another program is using is left alone.
  static std::unique_ptr<OpenRig> open(const rig::RigFile& rig_file,
                                       std::vector<std::string>& problems);

  rig::GlfwProjector& projector() { return *projector_; }
  Devices devices() { return {*projector_, *trigger_, *camera_, *events_}; }

 private:
  OpenRig() = default;
  // The events outlive the devices that post to them.
  std::unique_ptr<rig::EventQueue> events_ = std::make_unique<rig::EventQueue>();
  std::unique_ptr<rig::AravisCamera> camera_;
  std::unique_ptr<rig::LibusbTrigger> trigger_;
  std::unique_ptr<rig::GlfwProjector> projector_;
};

}  // namespace capture
