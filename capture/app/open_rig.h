// The real devices of a rig, opened together.
#pragma once

#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/exit_code.h"
#include "capture/runner.h"
#include "rig/camera_trigger.h"
#include "rig/devices/aravis_camera.h"
#include "rig/devices/glfw_projector.h"
#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"
#include "rig/opening.h"
#include "rig/reopener.h"
#include "rig/rig_file.h"

namespace capture {

// Made, opened, closed and destroyed on the main thread (GLFW's rule); devices(), reopen() and
// finish() are for the session thread. Camera and trigger box are opened and closed on threads of
// their own (rig/opening.h), so that a stop is heard while a dead one is waited for.
class OpenRig final : public rig::Reopener {
 public:
  explicit OpenRig(const rig::RigFile& rig_file);
  // Waits for devices on their way, which takes seconds of dead ones; see close() and leave().
  ~OpenRig() override = default;

  // Tries every device, so that all that is missing is known at once: one sentence each in
  // `problems`. But a rig that another program is using is left alone. False: something is missing,
  // or `stop` came first. Once.
  bool open(const std::stop_token& stop, std::vector<std::string>& problems);
  // Lets go of the devices, after open() and whatever came of it. False: `stop` or `deadline` came
  // first.
  bool close(rig::HostTime deadline, const std::stop_token& stop);

  // Those that open() opened.
  rig::GlfwProjector& projector() { return *projector_; }
  const std::string& camera_note() const { return camera_.identity().note; }  // empty: none
  Devices devices() { return {*projector_, trigger(), camera_, *events_, this}; }

  // The projector's window finds its monitor again by itself; here is only asked whether it has.
  void reopen(rig::Device device) override;
  std::optional<rig::Result<void>> finish(rig::Device device) override;

 private:
  rig::Trigger& trigger();
  rig::EventSink& camera_sink();

  const rig::RigFile rig_file_;
  // The events outlive the devices that post to them.
  std::unique_ptr<rig::EventQueue> events_ = std::make_unique<rig::EventQueue>();
  std::optional<rig::CameraTrigger> camera_trigger_;  // in a rig without a trigger box
  rig::ReplaceableCamera camera_{nullptr};
  rig::ReplaceableTrigger trigger_{nullptr};
  std::unique_ptr<rig::GlfwProjector> projector_;
  std::optional<rig::CameraPast> camera_past_;  // used by camera_opening_'s thread alone
  rig::Opening<rig::Camera> camera_opening_;
  rig::Opening<rig::Trigger> trigger_opening_;
};

// Closes the devices at the program's end and returns `exit_code`. A device that takes its time at
// it, for it is dead, is not waited for: the process ends here. Everything is stored and told by
// then; a camera that was cut off in its opening may think itself taken for another 3 s.
ExitCode leave(std::unique_ptr<OpenRig> rig, ExitCode exit_code);

}  // namespace capture
