// Are the poses good enough, and which is missing: coverage of both pictures, variety of tilts,
// what is known of a point's depth, and the pose that would tell most.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "estimation/calibration/geometry_fit.h"

namespace estimation {

// Corners counted on a grid over a picture.
struct Coverage {
  static constexpr int kCols = 6, kRows = 4;
  std::vector<int> corner_count;  // [row][col]
  double covered_frac = 0;        // cells with a corner
};

// Of everything the poses must bring. Limits for a rig to be called calibrated.
struct GeometryLimits {
  int min_pose_count = 6;
  double min_camera_coverage_frac = 0.5;
  double min_projector_coverage_frac = 0.35;  // the camera may see only a part of the projector's
  double min_tilt_deg = 20;                   // largest angle between any two poses
  double min_tilt_spread_deg = 4;  // standard deviation of the tilts, in the lesser direction
  double max_rms_px = 0.5;         // of a device; beyond it something is wrong with the board
  double outlier_ratio = 3;        // a pose's rms over the median of all
  double outlier_least_rms_px = 0.15;
  double max_depth_sd_frac = 3e-4;  // of the distance: 0.3 mm at a metre
};

struct GeometryCheck {
  Coverage camera, projector;
  double largest_tilt_deg = 0;  // between two poses
  double tilt_spread_deg = 0;   // standard deviation in the lesser of two directions
  double nearest_mm = 0, farthest_mm = 0;
  // Standard deviation of a triangulated depth from the calibration alone: rms over the picture at
  // the poses' distances; 0 without a fit.
  double depth_sd_mm = 0;
  std::vector<std::string>
      refusals;  // why this is no calibration, and what to do; empty: it is one
};

// `camera` says which part of the sensor the frames show.
GeometryCheck check_geometry(const GeometryFit& fit, const CameraInfo& camera,
                             const ProjectorInfo& projector, const GeometryLimits& limits);

}  // namespace estimation
