#include "estimation/motion/motion_scale.h"

#include <cmath>

#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

// Depth along `direction` (z = 1) where the point is `distance_mm` from the projector's centre; the
// farther of the two.
std::optional<double> depth_at(const Vec3& direction, const Vec3& projector_mm,
                               double distance_mm) {
  const double a = direction.dot(direction), b = -2 * direction.dot(projector_mm);
  const double c = projector_mm.dot(projector_mm) - distance_mm * distance_mm;
  const double discriminant = b * b - 4 * a * c;
  if (discriminant < 0) return std::nullopt;
  const double depth_mm = (-b + std::sqrt(discriminant)) / (2 * a);
  return depth_mm > 0 ? std::optional(depth_mm) : std::nullopt;
}

// Depth along `direction` where it comes closest to the projector's axis.
std::optional<double> depth_of_meeting(const Vec3& direction, const Vec3& projector_mm,
                                       const Vec3& projector_axis) {
  // The part of both across the axis: the ray's distance from it is least where they cancel.
  const Vec3 across = direction - projector_axis * direction.dot(projector_axis);
  const Vec3 offset = projector_mm - projector_axis * projector_mm.dot(projector_axis);
  const double square = across.dot(across);
  constexpr double kParallel = 1e-6;  // a thousandth of a radian
  if (square < kParallel) return std::nullopt;
  const double depth_mm = across.dot(offset) / square;
  return depth_mm > 0 ? std::optional(depth_mm) : std::nullopt;
}

}  // namespace

MotionScale motion_scale(const CameraInfo& camera, const Calibration& calibration, Axis axis) {
  const bool is_column = axis == Axis::kColumn;
  MotionScale scale;
  scale.across_row = is_column ? 0 : 1;
  scale.across_col = is_column ? 1 : 0;
  const Mat3& K = calibration.projector.K;
  const Stereo stereo(calibration, camera);
  scale.projector_px_per_px = (is_column ? K(0, 0) : K(1, 1)) / stereo.camera_focal_px();
  const auto ray = stereo.ray(0.5 * (camera.height_px - 1), 0.5 * (camera.width_px - 1));
  if (!ray) return scale;
  const bool has_reference =
      calibration.irradiance && calibration.irradiance->reference_distance_mm;
  const Vec3 projector_axis = calibration.projector_from_camera.t() * Vec3(0, 0, 1);
  const auto depth_mm =
      has_reference
          ? depth_at(ray->direction, stereo.projector_centre_mm(),
                     *calibration.irradiance->reference_distance_mm)
          : depth_of_meeting(ray->direction, stereo.projector_centre_mm(), projector_axis);
  if (!depth_mm) return scale;
  const Vec3 point_mm = ray->direction * *depth_mm;
  const auto lit = stereo.project(point_mm);
  if (!lit) return scale;
  const Vec3& by_point = is_column ? lit->column_gradient_px_per_mm : lit->row_gradient_px_per_mm;
  // The coordinate at a pixel, by pixel (on a surface across the camera's axis) and by depth.
  const Mat2& by_pixel = ray->normalized_by_pixel;
  const double by_col = *depth_mm * (by_point[0] * by_pixel(0, 0) + by_point[1] * by_pixel(1, 0));
  const double by_row = *depth_mm * (by_point[0] * by_pixel(0, 1) + by_point[1] * by_pixel(1, 1));
  const double slope = std::hypot(by_row, by_col);
  if (!(slope > 0)) return scale;
  scale.across_row = by_row / slope;
  scale.across_col = by_col / slope;
  scale.projector_px_per_px = slope;
  scale.distance_mm = *depth_mm;
  scale.lateral_mm_per_px = *depth_mm / stereo.camera_focal_px();
  const double by_depth = by_point.dot(ray->direction);  // px per mm
  constexpr double kMostDepthForShift = 20;  // times the sideways motion: beyond, depth is not seen
  const double depth_mm_per_px = -slope / by_depth;
  if (std::abs(depth_mm_per_px) < kMostDepthForShift * *scale.lateral_mm_per_px)
    scale.depth_mm_per_px = depth_mm_per_px;
  return scale;
}

}  // namespace estimation
