// What a shift in the frame is in the projector's picture and in the world, at the distance the rig
// was calibrated for.
#pragma once

#include <optional>

#include "estimation/session/manifest.h"

namespace estimation {

// Around the middle of the frame, for a pattern that varies along one axis of the projector. A
// surface that comes nearer moves the pattern's edges across themselves; one that moves sideways
// takes its own picture along.
struct MotionScale {
  // Unit vector in the frame along which the pattern's coordinate grows, and how fast it does.
  double across_row = 0, across_col = 1;
  double projector_px_per_px = 1;
  // mm; without value where the calibration tells no distance.
  std::optional<double> distance_mm;        // from the camera, along its axis
  std::optional<double> lateral_mm_per_px;  // of the frame, sideways
  // Towards the camera, by the shift across the edges; none where depth hardly moves them.
  std::optional<double> depth_mm_per_px;
};

// The distance is that of the irradiance's reference, else where the axes of camera and projector
// come closest.
MotionScale motion_scale(const CameraInfo& camera, const Calibration& calibration, Axis axis);

}  // namespace estimation
