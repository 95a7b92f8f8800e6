// Captures' frames straight from a simulated scene, without devices or files: what the benches of
// the watches on motion and pictures share.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "estimation/base/image.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world/effects.h"
#include "hw_sim/world/head_world.h"
#include "tests/bench/world_capture.h"

namespace bench {

struct SceneFramesOptions {
  std::string rig_file, scene = "face_female";
  bool is_in_order = false;  // stripes by their shift, whatever the rig file says
  double cycle_ms = 66.7;    // from pattern to pattern
  std::uint64_t seed = 1;
};

struct SceneFrame {
  int pattern = 0, bracket = 0;
  double at_s = 0;       // of the world's time
  double elapsed_s = 0;  // of the capture
  double exposure_s = 0;
};
using OnSceneFrame =
    std::function<void(const SceneFrame&, estimation::ImageView<const std::uint16_t>)>;

class SceneFrames {
 public:
  // `effects_of`: of a capture that lasts so many seconds. nullptr: complained.
  static std::unique_ptr<SceneFrames> open(
      const Program& program, const SceneFramesOptions& options,
      const std::function<hw_sim::Effects(double capture_s)>& effects_of);

  // The whole plan in its order; captures begin a second after the end of the one before.
  void capture(int number, const OnSceneFrame& on_frame);

  const estimation::CameraInfo& camera() const { return rig_.camera; }
  const estimation::Calibration& calibration() const { return rig_.calibration; }
  const capture::Plan& plan() const { return plan_; }
  const hw_sim::Effects& effects() const { return effects_; }

 private:
  SceneFrames(const SceneFramesOptions& options, const rig::RigFile& file, hw_sim::SimulatedRig rig,
              capture::Plan plan, const hw_sim::Effects& effects,
              std::unique_ptr<hw_sim::HeadWorld> world);

  const double cycle_s_;
  const hw_sim::SimulatedRig rig_;
  const capture::Plan plan_;
  const hw_sim::Effects effects_;
  const std::unique_ptr<hw_sim::HeadWorld> world_;
  std::vector<std::shared_ptr<const hw_sim::Picture>> pictures_;
  std::uint64_t trigger_number_ = 0;
};

}  // namespace bench
