// What a calibration is made from: the corners of a flat board in several poses, each where the
// camera sees it and where the projector lights it.
#pragma once

#include <opencv2/core/matx.hpp>
#include <string>
#include <vector>

#include "estimation/geometry/lens.h"

namespace estimation {

// One corner in one pose. Pixels of the sensor and of the projector, pixel centres at integers.
struct BoardCorner {
  Vec2 board_mm;   // on the board's own plane
  Vec2 camera_px;  // (col, row) on the sensor, whatever part of it the frames show
  Vec2 projector_px;
  bool has_projector = true;  // false: not lit, or not decoded
  double camera_sd_px = 0.1;  // of each coordinate
  double projector_sd_px = 0.1;
  // Where the projector's coordinate was read at the camera's corner, an error of the corner goes
  // along: d projector_px / d camera_px on the board. Zero: the two were measured independently.
  Mat2 projector_by_camera = Mat2::zeros();
};

struct BoardPose {
  std::string name;  // of its session, for people
  std::vector<BoardCorner> corners;
};

}  // namespace estimation
