// The real devices of a rig, opened together.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/runner.h"
#include "rig/camera_trigger.h"
#include "rig/devices/aravis_camera.h"
#include "rig/devices/glfw_projector.h"
#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"
#include "rig/reopener.h"
#include "rig/rig_file.h"

namespace capture {

// Made and destroyed on the main thread (GLFW's rule); devices(), close() and open() are for the
// session thread.
class OpenRig final : public rig::Reopener {
 public:
  // Tries every device, so that all that is missing is known at once: one sentence each in
  // `problems`, and then nullptr. But a rig that another program is using is left alone.
  static std::unique_ptr<OpenRig> open(const rig::RigFile& rig_file,
                                       std::vector<std::string>& problems);

  rig::GlfwProjector& projector() { return *projector_; }
  Devices devices() { return {*projector_, trigger(), *camera_, *events_, this}; }

  void close(rig::Device device) override;
  // The projector's window finds its monitor again by itself; here is only asked whether it has.
  rig::Result<void> open(rig::Device device) override;

 private:
  explicit OpenRig(const rig::RigFile& rig_file);
  rig::Trigger& trigger();
  rig::EventSink& camera_sink();

  const rig::RigFile rig_file_;
  // The events outlive the devices that post to them.
  std::unique_ptr<rig::EventQueue> events_ = std::make_unique<rig::EventQueue>();
  std::optional<rig::CameraTrigger> camera_trigger_;  // in a rig without a trigger box
  std::optional<rig::ReplaceableCamera> camera_;
  std::optional<rig::ReplaceableTrigger> trigger_;
  std::unique_ptr<rig::GlfwProjector> projector_;
};

}  // namespace capture
