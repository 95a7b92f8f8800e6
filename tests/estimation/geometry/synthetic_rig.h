// A calibrated pair like the paper's: camera and projector a metre away, 250 mm apart, and surfaces
// of known shape seen through it. Projections here use OpenCV's own projectPoints.
#pragma once

#include <cmath>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <optional>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/session/manifest.h"

namespace estimation::testing {

struct SyntheticRig {
  Calibration calibration;
  CameraInfo camera;
  ProjectorInfo projector{1024, 768, {}};
};

// `width_px` columns of camera over about 310 mm at 1 m; the projector turned towards the subject.
inline SyntheticRig make_rig(int width_px, int height_px, bool with_distortion) {
  SyntheticRig rig;
  rig.camera.width_px = width_px;
  rig.camera.height_px = height_px;
  const double focal_px = width_px / 0.31;
  rig.calibration.camera.K =
      Mat3(focal_px, 0, (width_px - 1) / 2.0, 0, focal_px, (height_px - 1) / 2.0, 0, 0, 1);
  rig.calibration.projector.K = Mat3(3400, 0, 511.5, 0, 3400, 383.5, 0, 0, 1);
  const double angle_rad = std::atan(0.25);
  Mat3 rotation;
  cv::Rodrigues(Vec3(0.02, angle_rad, 0.01), rotation);
  rig.calibration.projector_from_camera = rotation;
  rig.calibration.projector_from_camera_mm = -(rotation * Vec3(250, 8, 0));
  if (with_distortion) {
    rig.calibration.camera.distortion = {-0.12, 0.08, 0.0008, -0.0005, 0.01};
    rig.calibration.projector.distortion = {0.09, -0.06, -0.001, 0.0007, 0.02};
  }
  return rig;
}

inline cv::Vec2d opencv_pixel(const Lens& lens, const Vec3& point_mm) {
  std::vector<cv::Point2d> pixels;
  const std::vector<cv::Point3d> points{cv::Point3d(point_mm)};
  const std::vector<double> distortion(lens.distortion.begin(), lens.distortion.end());
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), cv::Mat(lens.K), distortion, pixels);
  return {pixels[0].x, pixels[0].y};
}

inline cv::Vec2d projector_pixel(const SyntheticRig& rig, const Vec3& point_mm) {
  return opencv_pixel(rig.calibration.projector, rig.calibration.projector_from_camera * point_mm +
                                                     rig.calibration.projector_from_camera_mm);
}

// A surface: where a ray (x, y, 1) from the camera meets it first, and its unit normal there.
struct SyntheticSurface {
  std::function<std::optional<double>(const Vec3& direction)> depth_mm;
  std::function<Vec3(const Vec3& point_mm)> normal;  // towards the camera
};

inline SyntheticSurface plane(const Vec3& through_mm, const Vec3& direction) {
  const Vec3 normal = direction / cv::norm(direction) * (direction[2] > 0 ? -1 : 1);
  return {[=](const Vec3& ray) -> std::optional<double> {
            return normal.dot(through_mm) / normal.dot(ray);
          },
          [=](const Vec3&) { return normal; }};
}

inline SyntheticSurface sphere(const Vec3& centre_mm, double radius_mm) {
  return {[=](const Vec3& ray) -> std::optional<double> {
            const double a = ray.dot(ray), b = ray.dot(centre_mm);
            const double c = centre_mm.dot(centre_mm) - radius_mm * radius_mm;
            const double discriminant = b * b - a * c;
            if (discriminant < 0) return std::nullopt;
            return (b - std::sqrt(discriminant)) / a;
          },
          [=](const Vec3& point_mm) { return (point_mm - centre_mm) / radius_mm; }};
}

}  // namespace estimation::testing
