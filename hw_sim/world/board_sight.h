// A calibration target as the camera sees it: where the projector lights each place, what comes
// back, through the camera's lens on its pixels.
#pragma once

#include <array>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"
#include "hw_sim/light.h"
#include "hw_sim/world/board_scene.h"
#include "hw_sim/world/camera_blur.h"
#include "hw_sim/world/effects.h"

namespace hw_sim {

// Immutable, so thread-safe. Sums run in the caller's TBB arena.
class TargetSight {
 public:
  // `calibration` has the geometry and the irradiance's reference distance.
  TargetSight(const estimation::CameraInfo& camera, const estimation::ProjectorInfo& projector,
              const estimation::Calibration& calibration, const Target& target,
              const Effects& effects);

  // Light on the camera's pixels, relative to white on a reflectance of 1 at the reference
  // distance.
  estimation::Image<float> lit(const Picture& picture) const;
  // Of the room, likewise. All zero without any.
  const estimation::Image<float>& ambient() const { return ambient_; }
  // The projector's row that lights a pixel's middle.
  double projector_row_px(int row, int col) const;

 private:
  struct View;
  void look(const View& view);
  // Own coordinates of the lattice's corners on the target, [row][col].
  std::vector<cv::Vec2d> corners_mm(const View& view) const;
  double reflectance(const std::array<cv::Vec2d, 4>& corners) const;
  // Of a picture's white, [place] 0..1, with what the target spreads of it.
  std::vector<float> spread_light(const Picture& picture) const;
  estimation::Image<float> on_pixels(estimation::Image<float> fine) const;
  std::size_t at(int row, int col) const;

  Target target_;
  Effects effects_;
  int projector_width_px_, projector_height_px_;
  // A lens blurs before pixels add up: a blurred picture is made on a lattice so much finer.
  int fine_;
  int width_, height_;  // of the lattice
  // [place of the lattice]
  std::vector<float> column_px_, row_px_;  // where the projector lights it
  std::vector<float> blur_px_;
  std::vector<float> px_per_mm_;  // of the projector, on a surface that faces it
  std::vector<float> share_;      // of a reflectance of 1 that faces the projector at its distance
  CameraBlur camera_blur_;
  estimation::Image<float> ambient_;
};

}  // namespace hw_sim
