// Camera, projector and how they stand to each other: rays, projections and points, in double.
#pragma once

#include <limits>
#include <optional>

#include "estimation/base/linear.h"
#include "estimation/geometry/lens.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Where a surface point is lit from, as decoded; an axis not decoded has infinite sd.
struct ProjectorReading {
  double column_px = 0, column_sd_px = std::numeric_limits<double>::infinity();
  double row_px = 0, row_sd_px = std::numeric_limits<double>::infinity();
};

// Immutable, so thread-safe. All points and directions in camera coordinates, mm.
class Stereo {
 public:
  // `camera` gives the frames' place on the sensor, which the intrinsics refer to.
  Stereo(const Calibration& calibration, const CameraInfo& camera);

  struct Ray {
    Vec3 direction;            // z = 1: a point on it is direction * depth
    Mat2 normalized_by_pixel;  // derivative of (x, y) by (col, row)
  };
  std::optional<Ray> ray(double row, double col) const;

  struct Projection {
    Vec2 pixel;                      // projector column, row
    Vec3 column_gradient_px_per_mm;  // of the column by the point
    Vec3 row_gradient_px_per_mm;
  };
  // Nullopt behind the projector.
  std::optional<Projection> project(const Vec3& point_mm) const;

  struct Depth {
    double depth_mm = 0;  // along the camera's axis
    double sd_mm = 0;
    double epipolar_px = 0;  // how far column and row are from the ray's image, 0 with one axis
  };
  // The point on the ray that agrees best with the reading, by least squares in projector px.
  // Nullopt where there is none in front of both devices.
  std::optional<Depth> triangulate(const Ray& ray, const ProjectorReading& reading) const;

  const Vec3& projector_centre_mm() const { return projector_centre_mm_; }
  double camera_focal_px() const { return camera_.focal_px(); }

 private:
  std::optional<double> first_depth_mm(const Vec3& direction,
                                       const ProjectorReading& reading) const;

  LensModel camera_, projector_;
  Vec2 roi_px_;
  Mat3 projector_from_camera_;
  Vec3 projector_from_camera_mm_;
  Vec3 projector_centre_mm_;
};

}  // namespace estimation
