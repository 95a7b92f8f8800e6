// Calibration targets in front of the simulated camera: flat and matte, under the projector's light
// with its blur, gamma, black, vignetting, ripple and scan-out, through the camera's blur on an
// image sensor with its faults. A target is grey: crosstalk of the bands does not show. Rays and
// sums are this folder's own. The next target is there as soon as the next capture has begun.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>

#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world.h"
#include "hw_sim/world/board_scene.h"
#include "hw_sim/world/effects.h"
#include "rig/fault.h"

namespace hw_sim {

// How many captures have begun so far: the n-th has the n-th step of the scene. Called from
// exposing threads.
using CaptureCount = std::function<std::size_t()>;

// Thread-safe.
class TargetWorld final : public World {
 public:
  // Errors: kConfiguration for a camera or calibration that lacks what a simulated picture needs
  // (black level, gain, read noise, irradiance); kUnsupported for effects that targets do not have
  // (drift, a flickering room, pixels that light less than their square).
  static rig::Result<std::unique_ptr<TargetWorld>> create(
      const estimation::CameraInfo& camera, const estimation::ProjectorInfo& projector,
      const estimation::Calibration& calibration, TargetScene scene, const Effects& effects,
      std::uint64_t seed, CaptureCount captures_begun);
  ~TargetWorld() override;

  int width_px() const override;
  int height_px() const override;
  int channel_count() const override;
  void expose(const Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override;
  LampTiming lamp_timing() const override;
  void prepare(const std::shared_ptr<const Picture>& picture) const override;

  // target.json, what the capture of that step had before it: {"name", "middle_mm", "normal" (unit,
  // towards the camera), "reflectance"}; the folder is made if absent.
  estimation::Result<void> write_truth(const std::filesystem::path& folder, std::size_t step) const;

 private:
  struct Parts;
  explicit TargetWorld(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace hw_sim
