// Which pose of the board is missing: the one whose corners would tell most.
#pragma once

#include <span>
#include <string>

#include "estimation/calibration/geometry_fit.h"

namespace estimation {

struct PoseAdvice {
  std::string text;  // "turn the board by about 30 degrees so that it faces the left ..."
  // By how much the depth's standard deviation would shrink; 0 before there is a fit.
  double expected_gain_frac = 0;
};

// The next pose to show. Before a fit exists (`fit` null): the first poses of every calibration, by
// how many there are. Afterwards the candidate (tilt, place in the picture, distance) whose
// corners would reduce the depth's uncertainty most.
PoseAdvice advise_pose(const GeometryFit* fit, std::size_t pose_count,
                       std::span<const Vec2> board_corners_mm, const CameraInfo& camera,
                       const ProjectorInfo& projector);

}  // namespace estimation
