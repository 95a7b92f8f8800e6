// The light of a scene before the shutter: which picture gives which signal at every sample of the
// frame, with everything that optics, room and subject do to it.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hw_sim/world/camera_blur.h"
#include "hw_sim/world/direct_light.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/interreflection.h"
#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/seen_points.h"
#include "hw_sim/world/shutter_light.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {

// What of the subject differs from one moment to the next.
struct Moment {
  estimation::Vec3 displacement_mm{0, 0, 0};
  double blink_frac = 0;  // 1: eyes open
  bool operator==(const Moment&) const = default;
};

// Immutable once prepared, so thread-safe. Everything runs in the caller's TBB arena.
class HeadLight {
 public:
  using Progress = std::function<void(double done_frac, const std::string& what)>;

  HeadLight(const estimation::CameraInfo& camera, const estimation::ProjectorInfo& projector,
            const estimation::Calibration& calibration, const SceneOptions& options, Scene scene,
            const Progress& progress);

  // DN/us above black without noise, [height][width][channel], under a picture.
  estimation::Image<float> linear_image(const Picture& picture, const Moment& moment) const;
  // The room's own, in the mean over its flicker; empty in a dark room.
  const estimation::Image<float>& room_light() const { return room_; }
  // [frame sample], as ShutterLight counts; empty where there is one slot.
  const std::vector<std::uint32_t>& slots() const { return slots_; }
  Moment moment(double begin_s, double end_s) const;  // since the first exposure
  estimation::Result<void> write_truth(const std::filesystem::path& folder) const;

 private:
  TotalReflectance total_reflectance() const;
  const ScatterTable* table() const { return scattering_ ? &*scattering_ : nullptr; }
  void prepare_transport(const estimation::ProjectorInfo& projector, const Progress& progress);
  void prepare_indirect();
  void prepare_samples();
  void prepare_wall();
  void prepare_frame();
  void prepare_slots();
  std::vector<float> reflected(const Picture& picture, const Moment& moment) const;
  std::size_t frame_sample_count() const;
  std::size_t frame_sample(int row, int col, int channel) const;
  double lamp_passes(double row_px, double col_px) const;
  bool has_wall() const { return options_.effects.backdrop_reflectance_frac > 0; }

  const estimation::CameraInfo camera_;
  const estimation::Calibration calibration_;
  const SceneOptions options_;
  const Pinhole eye_, lamp_;
  const int channel_count_;
  std::unique_ptr<SkinMap> skin_;
  std::unique_ptr<Surface> surface_;
  std::unique_ptr<ProjectorLight> light_;
  SeenPoints seen_;
  std::optional<ScatterTable> scattering_;  // none: the paper's dipole
  Transport transport_;
  Interreflection indirect_;

  // Of the effects, what stays. By sample of `seen_`:
  LineOptics optics_;
  std::vector<float> lamp_passes_;
  std::vector<Slide> slides_;  // empty: nobody moves
  // By sample of the frame:
  DirectLight direct_;              // shine and wall
  DirectLight eyes_;                // between open lids
  std::vector<float> scale_;        // DN/us of a reflectance factor of 1
  std::vector<float> under_white_;  // reflectance factor; empty: the projector's black is dark
  std::vector<std::uint32_t> slots_;
  estimation::Image<float> room_;
  CameraBlur blur_;
};

}  // namespace hw_sim
