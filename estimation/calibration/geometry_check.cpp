#include "estimation/calibration/geometry_check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "estimation/calibration/depth_bound.h"
#include "estimation/calibration/pose_statistics.h"

namespace estimation {
namespace {

std::string number(double value, int digits, const char* unit = "") {
  char text[48];
  std::snprintf(text, sizeof text, "%.*f%s", digits, value, unit);
  return text;
}

Coverage cover(const GeometryFit& fit, bool is_projector, const Vec2& origin_px, int width_px,
               int height_px) {
  Coverage coverage{.corner_count = std::vector<int>(Coverage::kRows * Coverage::kCols)};
  for (const PoseFit& pose : fit.poses)
    for (const PoseFit::Residual& corner : pose.residuals) {
      if (is_projector && !corner.has_projector) continue;
      const Vec2 px = (is_projector ? corner.projector_px : corner.camera_px) - origin_px;
      const int col = static_cast<int>(std::floor((px[0] + 0.5) / width_px * Coverage::kCols));
      const int row = static_cast<int>(std::floor((px[1] + 0.5) / height_px * Coverage::kRows));
      if (col < 0 || row < 0 || col >= Coverage::kCols || row >= Coverage::kRows) continue;
      ++coverage.corner_count[static_cast<std::size_t>(row * Coverage::kCols + col)];
    }
  const auto covered = std::ranges::count_if(coverage.corner_count, [](int n) { return n > 0; });
  coverage.covered_frac =
      static_cast<double>(covered) / static_cast<double>(coverage.corner_count.size());
  return coverage;
}

double largest_tilt_deg(const GeometryFit& fit) {
  double largest = 0;
  for (const PoseFit& a : fit.poses)
    for (const PoseFit& b : fit.poses)
      largest = std::max(largest, std::acos(std::clamp(a.normal.dot(b.normal), -1.0, 1.0)));
  return largest / kDegree;
}

double median_rms(const GeometryFit& fit, double PoseFit::*rms) {
  std::vector<double> values;
  for (const PoseFit& pose : fit.poses)
    if (pose.*rms > 0) values.push_back(pose.*rms);
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Poses that do not fit the others.
void refuse_outliers(const GeometryFit& fit, const GeometryLimits& limits, GeometryCheck& check) {
  const double camera_px = median_rms(fit, &PoseFit::camera_rms_px);
  const double projector_px = median_rms(fit, &PoseFit::projector_rms_px);
  const auto is_out = [&](double rms_px, double median_px) {
    return rms_px > std::max(limits.outlier_ratio * median_px, limits.outlier_least_rms_px);
  };
  for (const PoseFit& pose : fit.poses) {
    const bool is_camera = is_out(pose.camera_rms_px, camera_px);
    if (!is_camera && !is_out(pose.projector_rms_px, projector_px)) continue;
    const double rms_px = is_camera ? pose.camera_rms_px : pose.projector_rms_px;
    check.refusals.push_back(pose.name + " does not fit the others: its corners are off by " +
                             number(rms_px, 2, " px") + " rms in the " +
                             (is_camera ? "camera" : "projector") + ", the others' median is " +
                             number(is_camera ? camera_px : projector_px, 2, " px") +
                             "; did the board move or bend? Retake this pose or leave it out");
  }
}

void refuse_poverty(const GeometryFit& fit, const GeometryLimits& limits, double distance_mm,
                    GeometryCheck& check) {
  const auto refuse = [&check](const std::string& reason) { check.refusals.push_back(reason); };
  if (static_cast<int>(fit.poses.size()) < limits.min_pose_count)
    refuse(std::to_string(fit.poses.size()) + " poses are too few; show the board in at least " +
           std::to_string(limits.min_pose_count) + ", better 15");
  const auto refuse_coverage = [&](const Coverage& coverage, double least, const char* device) {
    if (coverage.covered_frac >= least) return;
    refuse("the corners cover " + number(100 * coverage.covered_frac, 0, "%") + " of the " +
           device + "'s picture, expected at least " + number(100 * least, 0, "%") +
           "; show the board near the picture's borders too");
  };
  refuse_coverage(check.camera, limits.min_camera_coverage_frac, "camera");
  refuse_coverage(check.projector, limits.min_projector_coverage_frac, "projector");
  if (check.largest_tilt_deg < limits.min_tilt_deg ||
      check.tilt_spread_deg < limits.min_tilt_spread_deg)
    refuse("the tilts are too alike (at most " + number(check.largest_tilt_deg, 0) +
           " degrees between two poses, a spread of " + number(check.tilt_spread_deg, 1) +
           " degrees in the direction that varies less); turn the board left, right, up and down "
           "by about 35 degrees");
  if (fit.camera_rms_px > limits.max_rms_px || fit.projector_rms_px > limits.max_rms_px)
    refuse("the corners are off by " + number(fit.camera_rms_px, 2, " px") +
           " rms in the camera and " + number(fit.projector_rms_px, 2, " px") +
           " in the projector, expected at most " + number(limits.max_rms_px, 1, " px") +
           "; is the board flat, are its squares all of one size, are the pictures sharp?");
  if (!fit.is_converged) refuse("the joint refinement did not converge; retake the poses");
  if (check.depth_sd_mm > limits.max_depth_sd_frac * distance_mm)
    refuse("a depth would be known to " + number(check.depth_sd_mm, 2, " mm") + " only, expected " +
           number(limits.max_depth_sd_frac * distance_mm, 2, " mm") +
           "; add poses, tilted more and larger in the picture");
}

}  // namespace

GeometryCheck check_geometry(const GeometryFit& fit, const CameraInfo& camera,
                             const ProjectorInfo& projector, const GeometryLimits& limits) {
  GeometryCheck check;
  check.camera =
      cover(fit, false, Vec2(camera.roi_x_px, camera.roi_y_px), camera.width_px, camera.height_px);
  check.projector = cover(fit, true, Vec2(0, 0), projector.width_px, projector.height_px);
  check.largest_tilt_deg = largest_tilt_deg(fit);
  check.tilt_spread_deg = tilt_spread_deg(normals_of(fit));
  check.nearest_mm = std::numeric_limits<double>::infinity();
  for (const PoseFit& pose : fit.poses) {
    check.nearest_mm = std::min(check.nearest_mm, pose.distance_mm);
    check.farthest_mm = std::max(check.farthest_mm, pose.distance_mm);
  }
  check.depth_sd_mm = depth_sd_mm(
      depth_sensitivity(fit.calibration, camera, projector, check.nearest_mm, check.farthest_mm),
      covariance_of(fit));
  refuse_outliers(fit, limits, check);
  refuse_poverty(fit, limits, usual_distance_mm(fit), check);
  return check;
}

}  // namespace estimation
