// A GigE Vision camera by Aravis. hw_sim has the same interface without wires
// (hw_sim/devices/sim_camera.h) and a camera for the far end of this one's (hw_sim/gige).
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "rig/camera.h"
#include "rig/event.h"

namespace rig {

// A feature as it was: a number, or else its text. Under that entry of a selector, if there is one.
struct FeatureState {
  std::string selector;
  std::string entry;
  std::string name;
  std::variant<double, std::string> value;
};
using CameraLook = std::vector<FeatureState>;

// A camera that was open, so that it can be opened as the same and set as it was.
struct CameraPast {
  CameraIdentity identity;
  CameraLook look;  // what the rig file does not say: gain, black level, binning ...
};

// Calls as in Camera: from the thread that runs the session. Starts one thread while armed, which
// checks each buffer and posts it, and one to disarm; Aravis has its own for heartbeat and
// reception.
//
// A lost camera (heartbeat, control taken away) posts one DeviceFault{kDeviceLost}; its features
// are not touched again. disarm() then returns at once, but the destructor waits for Aravis to give
// up on the dead camera, up to 12 s. disarm() within the 5 s in which a dead camera is not yet
// known to be lost takes a second, after which it is.
class AravisCamera final : public Camera {
 public:
  // Opens, takes control, verifies the serial number, writes and reads back every setting. With
  // `past` it must be the same camera as then, and is set as it was: one that lost its power has
  // forgotten. Errors: kNotFound (no camera answers, or it is another one); kAccessDenied (another
  // program controls it); kUnsupported and kReadBackMismatch, naming the feature; kOutOfRange;
  // kDeviceLost.
  static Result<std::unique_ptr<AravisCamera>> open(const CameraSettings& settings, EventSink& sink,
                                                    const std::optional<CameraPast>& past = {});
  ~AravisCamera() override;

  const CameraIdentity& identity() const override;
  Result<void> arm(const std::vector<std::chrono::microseconds>& bracket_exposures,
                   int frame_count) override;
  void disarm() noexcept override;
  Result<CameraCounters> counters() override;
  Result<CameraClockSample> read_clock() override;
  Result<void> trigger_software() override;
  CameraPast past() const;
  // What GigE Vision sends in one packet, headers included: as negotiated.
  int packet_size_bytes() const;

 private:
  class Impl;
  explicit AravisCamera(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rig
