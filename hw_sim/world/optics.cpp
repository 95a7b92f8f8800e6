#include "hw_sim/world/optics.h"

#include <cmath>

namespace hw_sim {

using estimation::Mat3;
using estimation::Vec3;

namespace {

cv::Vec2d distort(const std::array<double, 5>& d, const cv::Vec2d& point) {
  const double x = point[0], y = point[1], r2 = x * x + y * y;
  const double radial = 1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  return {x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x),
          y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y};
}

}  // namespace

Pinhole::Pinhole(const estimation::Lens& lens, const Mat3& device_from_camera,
                 const Vec3& device_from_camera_mm)
    : lens_(lens),
      rotation_(device_from_camera),
      translation_mm_(device_from_camera_mm),
      center_mm_(-(device_from_camera.t() * device_from_camera_mm)) {}

cv::Vec2d Pinhole::undistorted(double col_px, double row_px) const {
  const Mat3& K = lens_.K;
  const double y = (row_px - K(1, 2)) / K(1, 1);
  const cv::Vec2d target((col_px - K(0, 2) - K(0, 1) * y) / K(0, 0), y);
  // Fixed point: each step removes the distortion found at the last estimate. Lenses of a rig
  // contract by far more than 10 a step, so 12 steps reach the last bit.
  cv::Vec2d point = target;
  for (int i = 0; i < 12; ++i) {
    const cv::Vec2d step = target - distort(lens_.distortion, point);
    if (step == cv::Vec2d(0, 0)) break;  // as a lens without distortion at once
    point += step;
  }
  return point;
}

Ray Pinhole::ray(double col_px, double row_px) const {
  const cv::Vec2d point = undistorted(col_px, row_px);
  const Vec3 direction = rotation_.t() * Vec3(point[0], point[1], 1);
  return {center_mm_, direction / cv::norm(direction)};
}

double Pinhole::solid_angle_sr(double col_px, double row_px, double size_px) const {
  const double half = size_px / 2;
  const cv::Vec2d along_col =
      undistorted(col_px + half, row_px) - undistorted(col_px - half, row_px);
  const cv::Vec2d along_row =
      undistorted(col_px, row_px + half) - undistorted(col_px, row_px - half);
  const cv::Vec2d point = undistorted(col_px, row_px);
  const double area = std::abs(along_col[0] * along_row[1] - along_col[1] * along_row[0]);
  return area / std::pow(1 + point.dot(point), 1.5);
}

ProjectedPoint Pinhole::project(const Vec3& point_mm) const {
  const Vec3 local = rotation_ * point_mm + translation_mm_;
  if (local[2] <= 0) return {};
  const cv::Vec2d point = distort(lens_.distortion, {local[0] / local[2], local[1] / local[2]});
  const Mat3& K = lens_.K;
  return {K(0, 0) * point[0] + K(0, 1) * point[1] + K(0, 2), K(1, 1) * point[1] + K(1, 2), true};
}

}  // namespace hw_sim
