#include "estimation/geometry/triangulation.h"

#include <cmath>

namespace estimation {
namespace {

constexpr int kMaxIterations = 20;
// Newton's next step would be the square of this.
constexpr double kRelativeTolerance = 1e-9;

double inverse_square(double sd) { return 1 / (sd * sd); }

// std::hypot looks after overflow, for ten times the time.
double root_of_squares(double a, double b) { return std::sqrt(a * a + b * b); }

// A reading without an error of its own still needs a finite weight.
constexpr double kLeastSdPx = 1e-6;

}  // namespace

Stereo::Stereo(const Calibration& calibration, const CameraInfo& camera)
    : camera_(calibration.camera),
      projector_(calibration.projector),
      roi_px_(camera.roi_x_px, camera.roi_y_px),
      projector_from_camera_(calibration.projector_from_camera),
      projector_from_camera_mm_(calibration.projector_from_camera_mm),
      projector_centre_mm_(-(projector_from_camera_.t() * projector_from_camera_mm_)) {}

std::optional<Stereo::Ray> Stereo::ray(double row, double col) const {
  const auto seen = camera_.unimage(Vec2(col, row) + roi_px_);
  if (!seen) return std::nullopt;
  return Ray{{seen->normalized[0], seen->normalized[1], 1}, seen->normalized_by_pixel};
}

std::optional<Stereo::Projection> Stereo::project(const Vec3& point_mm) const {
  const Vec3 p = projector_from_camera_ * point_mm + projector_from_camera_mm_;
  if (!(p[2] > 0)) return std::nullopt;
  const Vec2 normalized(p[0] / p[2], p[1] / p[2]);
  const LensModel::Imaged imaged = projector_.image(normalized);
  // Normalised coordinates by the point in the projector's frame, then turned into the camera's.
  const Vec3 x_by_point = Vec3(1, 0, -normalized[0]) / p[2];
  const Vec3 y_by_point = Vec3(0, 1, -normalized[1]) / p[2];
  const Mat3 camera_from_projector = projector_from_camera_.t();
  const Mat2& by = imaged.pixel_by_normalized;
  return Projection{imaged.pixel,
                    camera_from_projector * (by(0, 0) * x_by_point + by(0, 1) * y_by_point),
                    camera_from_projector * (by(1, 0) * x_by_point + by(1, 1) * y_by_point)};
}

// Where the ray meets the plane (or best, the two planes) of the reading, the lens undistorted at
// the reading; a missing coordinate counts as the projector's centre. Exact without distortion.
std::optional<double> Stereo::first_depth_mm(const Vec3& direction,
                                             const ProjectorReading& reading) const {
  const bool has_column = std::isfinite(reading.column_sd_px);
  const bool has_row = std::isfinite(reading.row_sd_px);
  const Vec2 centre = projector_.image(Vec2(0, 0)).pixel;
  const auto lit = projector_.unimage(
      Vec2(has_column ? reading.column_px : centre[0], has_row ? reading.row_px : centre[1]));
  if (!lit) return std::nullopt;
  const Vec3 d = projector_from_camera_ * direction;
  const Vec3& t = projector_from_camera_mm_;
  double numerator = 0, denominator = 0;
  const auto add_plane = [&](int axis, double sd_px) {
    const double slope = d[axis] - lit->normalized[axis] * d[2];
    const double offset = t[axis] - lit->normalized[axis] * t[2];
    numerator -= slope * offset * inverse_square(sd_px);
    denominator += slope * slope * inverse_square(sd_px);
  };
  if (has_column) add_plane(0, reading.column_sd_px);
  if (has_row) add_plane(1, reading.row_sd_px);
  const double depth_mm = numerator / denominator;
  if (!(depth_mm > 0) || !std::isfinite(depth_mm)) return std::nullopt;
  return depth_mm;
}

std::optional<Stereo::Depth> Stereo::triangulate(const Ray& ray,
                                                 const ProjectorReading& given) const {
  ProjectorReading reading = given;
  reading.column_sd_px = root_of_squares(given.column_sd_px, kLeastSdPx);
  reading.row_sd_px = root_of_squares(given.row_sd_px, kLeastSdPx);
  const double column_weight = inverse_square(reading.column_sd_px);
  const double row_weight = inverse_square(reading.row_sd_px);
  std::optional<double> depth_mm = first_depth_mm(ray.direction, reading);
  if (!depth_mm) return std::nullopt;

  for (int i = 0; i < kMaxIterations; ++i) {
    const auto seen = project(ray.direction * *depth_mm);
    if (!seen) return std::nullopt;
    const double column_slope = seen->column_gradient_px_per_mm.dot(ray.direction);
    const double row_slope = seen->row_gradient_px_per_mm.dot(ray.direction);
    // A weight of zero times a reading that is not there must stay zero.
    const double column_residual = column_weight > 0 ? reading.column_px - seen->pixel[0] : 0;
    const double row_residual = row_weight > 0 ? reading.row_px - seen->pixel[1] : 0;
    const double precision =
        column_weight * column_slope * column_slope + row_weight * row_slope * row_slope;
    const double step_mm =
        (column_weight * column_slope * column_residual + row_weight * row_slope * row_residual) /
        precision;
    *depth_mm += step_mm;
    if (!(*depth_mm > 0)) return std::nullopt;
    if (std::abs(step_mm) > kRelativeTolerance * *depth_mm) continue;
    const bool has_both = column_weight > 0 && row_weight > 0;
    const double epipolar_px =
        has_both ? std::abs(column_residual * row_slope - row_residual * column_slope) /
                       root_of_squares(column_slope, row_slope)
                 : 0;
    return Depth{*depth_mm, 1 / std::sqrt(precision), epipolar_px};
  }
  return std::nullopt;
}

}  // namespace estimation
