// A whole rig in one process on a virtual clock: projector, photodiode, trigger box and camera
// around a World, joined by function calls where the real one has light and wires.
//
//   trigger_box   photodiode ─► box ─► pulses ─► camera
//   camera_line   photodiode ─► comparator ─► camera's line
//   software      trigger_software() ─► camera
#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <set>

#include "hw_sim/comparator.h"
#include "hw_sim/devices/sim_camera.h"
#include "hw_sim/devices/sim_photodiode.h"
#include "hw_sim/devices/sim_projector.h"
#include "hw_sim/devices/sim_trigger.h"
#include "hw_sim/devices/timeline.h"
#include "hw_sim/faults/fault_plan.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/light.h"
#include "hw_sim/world.h"
#include "rig/camera.h"
#include "rig/camera_trigger.h"
#include "rig/projector.h"
#include "rig/reopener.h"
#include "rig/rig_file.h"
#include "rig/trigger.h"

namespace hw_sim {

struct InProcessOptions {
  rig::ProjectorSettings projector;
  rig::TriggerSettings trigger;
  rig::CameraSettings camera;
  DisplayTiming display_timing;
  CameraTiming camera_timing;
  FaultPlan faults;
  rig::SyncMode sync = rig::SyncMode::kTriggerBox;
  std::chrono::milliseconds opening_time{0};  // how long a device takes to be opened, or not
};

// Not thread-safe. `world` outlives the rig; frames taken from it may outlive both.
class InProcessRig final : public rig::Reopener {
 public:
  InProcessRig(const World& world, InProcessOptions options);
  InProcessRig(const InProcessRig&) = delete;
  InProcessRig& operator=(const InProcessRig&) = delete;

  Timeline& timeline() { return timeline_; }
  SimProjector& projector() { return projector_; }
  rig::Trigger& trigger();
  SimCamera& camera() { return camera_; }
  void reopen(rig::Device device) override;
  std::optional<rig::Result<void>> finish(rig::Device device) override;
  // What the projector shows at this moment; nullptr before its first picture.
  std::shared_ptr<const Picture> picture_now() const;

 private:
  rig::Result<void> open(rig::Device device);
  void light(const std::shared_ptr<const Picture>& picture, bool is_square_light,
             const FlipFaults& faults);
  void level(int level_adc);
  void pulse(const LinePulse& pulse);
  void pulse_without_box();
  bool has_box() const { return options_.sync == rig::SyncMode::kTriggerBox; }
  void take_device_faults();
  void undo_after(std::chrono::milliseconds duration, std::function<void()> undo);

  const World& world_;
  const InProcessOptions options_;
  Timeline timeline_;
  FaultSchedule faults_;
  LightTimeline light_;
  SimCamera camera_;
  rig::CameraTrigger camera_trigger_;
  SimTrigger trigger_;
  Comparator comparator_;
  SimPhotodiode photodiode_;
  SimProjector projector_;
  std::set<rig::Device> openings_;                   // under way
  std::map<rig::Device, rig::Result<void>> opened_;  // what became of them, until asked for
};

}  // namespace hw_sim
