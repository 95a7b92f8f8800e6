// OpenCV's pinhole with lens distortion, both ways, with derivatives.
#pragma once

#include <opencv2/core.hpp>
#include <optional>

#include "estimation/base/linear.h"
#include "estimation/session/manifest.h"

namespace estimation {

using Vec2 = cv::Vec2d;
using Mat2 = cv::Matx22d;

// Normalised coordinates are (X/Z, Y/Z) in the device's frame, without distortion. Immutable, so
// thread-safe.
class LensModel {
 public:
  explicit LensModel(const Lens& lens);

  struct Imaged {
    Vec2 pixel;
    Mat2 pixel_by_normalized;  // derivative
  };
  Imaged image(const Vec2& normalized) const;

  struct Unimaged {
    Vec2 normalized;
    Mat2 normalized_by_pixel;  // derivative
  };
  // Newton's method to 1e-12. Nullopt where the distortion has no inverse (outside any real image).
  std::optional<Unimaged> unimage(const Vec2& pixel) const;

  double focal_px() const { return (K_(0, 0) + K_(1, 1)) / 2; }

 private:
  // Distorted normalised coordinates and their derivative.
  Imaged distort(const Vec2& normalized) const;

  Mat2 K_, K_inverse_;
  Vec2 principal_px_;
  std::array<double, 5> distortion_;
  bool is_distorted_;
};

}  // namespace estimation
