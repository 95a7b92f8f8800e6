// A camera or projector as the world sees it: OpenCV's pinhole with [k1, k2, p1, p2, k3], placed in
// camera coordinates (x right, y down, z forward, mm).
#pragma once

#include "estimation/base/linear.h"
#include "estimation/session/manifest.h"

namespace hw_sim {

struct Ray {
  estimation::Vec3 origin_mm;
  estimation::Vec3 direction;  // unit
};

struct ProjectedPoint {
  double col_px = 0;
  double row_px = 0;
  bool is_in_front = false;
};

// Immutable, so thread-safe.
class Pinhole {
 public:
  // X_device = R X_camera + t.
  Pinhole(const estimation::Lens& lens, const estimation::Mat3& device_from_camera,
          const estimation::Vec3& device_from_camera_mm);

  const estimation::Vec3& center_mm() const { return center_mm_; }
  double focal_px() const { return lens_.K(0, 0); }
  // The ray through an image point; integers are pixel centres.
  Ray ray(double col_px, double row_px) const;
  // Solid angle of the square of side `size_px` around an image point, sr.
  double solid_angle_sr(double col_px, double row_px, double size_px) const;
  ProjectedPoint project(const estimation::Vec3& point_mm) const;

 private:
  cv::Vec2d undistorted(double col_px, double row_px) const;  // z = 1 plane

  estimation::Lens lens_;
  estimation::Mat3 rotation_;
  estimation::Vec3 translation_mm_;
  estimation::Vec3 center_mm_;
};

}  // namespace hw_sim
