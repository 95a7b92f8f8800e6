// A whole rig in one process on a virtual clock: projector, photodiode, trigger box and camera
// around a World, joined by function calls where the real one has light and wires.
#pragma once

#include "hw_sim/devices/sim_camera.h"
#include "hw_sim/devices/sim_projector.h"
#include "hw_sim/devices/sim_trigger.h"
#include "hw_sim/devices/timeline.h"
#include "hw_sim/faults/fault_plan.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/light.h"
#include "hw_sim/world.h"
#include "rig/camera.h"
#include "rig/projector.h"
#include "rig/reopener.h"
#include "rig/trigger.h"

namespace hw_sim {

struct InProcessOptions {
  rig::ProjectorSettings projector;
  rig::TriggerSettings trigger;
  rig::CameraSettings camera;
  DisplayTiming display_timing;
  CameraTiming camera_timing;
  FaultPlan faults;
};

// Not thread-safe. `world` outlives the rig; frames taken from it may outlive both.
class InProcessRig final : public rig::Reopener {
 public:
  InProcessRig(const World& world, InProcessOptions options);
  InProcessRig(const InProcessRig&) = delete;
  InProcessRig& operator=(const InProcessRig&) = delete;

  Timeline& timeline() { return timeline_; }
  SimProjector& projector() { return projector_; }
  SimTrigger& trigger() { return trigger_; }
  SimCamera& camera() { return camera_; }
  void close(rig::Device device) override;
  rig::Result<void> open(rig::Device device) override;
  // What the projector shows at this moment; nullptr before its first picture.
  std::shared_ptr<const Picture> picture_now() const;

 private:
  void light(const std::shared_ptr<const Picture>& picture, bool is_square_light,
             const FlipFaults& faults);
  void pulse(const LinePulse& pulse);
  void take_device_faults();
  void undo_after(std::chrono::milliseconds duration, std::function<void()> undo);

  const World& world_;
  const InProcessOptions options_;
  Timeline timeline_;
  FaultSchedule faults_;
  LightTimeline light_;
  SimCamera camera_;
  SimTrigger trigger_;
  SimProjector projector_;
};

}  // namespace hw_sim
