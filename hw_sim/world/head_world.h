// A lit head in front of the simulated camera: a mesh with the paper's materials, subsurface
// transport integrated over its surface, light bouncing between its parts, optics, room and subject
// as Effects say, and an image sensor. Every frame carries its identity (identity_block.h).
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world.h"
#include "hw_sim/world/dipole.h"
#include "hw_sim/world/effects.h"
#include "rig/fault.h"

namespace hw_sim {

struct SceneOptions {
  std::string name = "face_female";  // see scene.h
  ScatteringModel scattering = ScatteringModel::kDipole;
  int photons_per_angle = 3'000'000;  // of Monte Carlo, see scatter_table.h
  Effects effects;
  bool has_indirect = true;            // light between parts of the face
  int bounces = 3;                     // of it
  bool has_identity = true;            // every frame says in a corner what made it
  std::uint64_t seed = 1;              // of the sensor's noise
  int thread_count = 0;                // 0: as many as there are cores
  std::filesystem::path cache_folder;  // where computed transport is kept; empty: nowhere
};

// $XDG_CACHE_HOME/ssrig, else ~/.cache/ssrig; empty where neither variable is set.
std::filesystem::path default_cache_folder();

// Thread-safe.
class HeadWorld final : public World {
 public:
  // Computes the light transport, or takes it from the cache: up to a minute at 588 x 432.
  // `progress` is told the share done and in a word of what, from one thread at a time.
  // Errors: kConfiguration for an unknown scene or a camera or calibration that lacks what a
  // simulated picture needs (black level, gain, read noise, irradiance, reference distance);
  // kUnsupported for optics that are not simulated.
  static rig::Result<std::unique_ptr<HeadWorld>> create(
      const estimation::CameraInfo& camera, const estimation::ProjectorInfo& projector,
      const estimation::Calibration& calibration, const SceneOptions& options,
      const std::function<void(double done_frac, const std::string& what)>& progress = {});
  ~HeadWorld() override;

  int width_px() const override;
  int height_px() const override;
  int channel_count() const override;
  void expose(const Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override;
  // Computes the picture's linear image and keeps it, with the few used last.
  void prepare(const std::shared_ptr<const Picture>& picture) const override;

  LampTiming lamp_timing() const override;

  // What the camera would see of a picture without noise: DN/us above black, [height][width]
  // [channel], `elapsed` after the first exposure. Computed anew.
  estimation::Image<float> linear_image(
      const Picture& picture, std::chrono::nanoseconds elapsed = std::chrono::nanoseconds(0)) const;

  // The maps of session_format.md that a perfect estimator would give, and scene.exr with the
  // channels region, border_distance_mm (to the nearest zone of mixed materials, silhouette, depth
  // jump or edge of a cast shadow; never more than it is), cos_projector, cos_camera and lit. They
  // hold where the subject was at the first exposure; poses.csv says how far it had moved at each
  // (of the latest 100,000), by trigger number and the host's clock.
  estimation::Result<void> write_truth(const std::filesystem::path& folder) const;

 private:
  struct Parts;
  explicit HeadWorld(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace hw_sim
