#include "estimation/geometry/lens.h"

#include <algorithm>
#include <cmath>

namespace estimation {
namespace {

constexpr int kMaxIterations = 30;
constexpr double kTolerance = 1e-13;

}  // namespace

LensModel::LensModel(const Lens& lens)
    : K_(lens.K(0, 0), lens.K(0, 1), lens.K(1, 0), lens.K(1, 1)),
      K_inverse_(K_.inv()),
      principal_px_(lens.K(0, 2), lens.K(1, 2)),
      distortion_(lens.distortion),
      is_distorted_(std::any_of(distortion_.begin(), distortion_.end(),
                                [](double value) { return value != 0; })) {}

LensModel::Imaged LensModel::distort(const Vec2& normalized) const {
  const auto [k1, k2, p1, p2, k3] = distortion_;
  const double x = normalized[0], y = normalized[1];
  const double r2 = x * x + y * y;
  const double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const double radial_by_r2 = k1 + r2 * (2 * k2 + r2 * 3 * k3);
  const Vec2 distorted(x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                       y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y);
  const double cross = 2 * x * y * radial_by_r2 + 2 * p1 * x + 2 * p2 * y;
  const Mat2 derivative(radial + 2 * x * x * radial_by_r2 + 2 * p1 * y + 6 * p2 * x, cross, cross,
                        radial + 2 * y * y * radial_by_r2 + 6 * p1 * y + 2 * p2 * x);
  return {distorted, derivative};
}

LensModel::Imaged LensModel::image(const Vec2& normalized) const {
  if (!is_distorted_) return {K_ * normalized + principal_px_, K_};
  const Imaged distorted = distort(normalized);
  return {K_ * distorted.pixel + principal_px_, K_ * distorted.pixel_by_normalized};
}

std::optional<LensModel::Unimaged> LensModel::unimage(const Vec2& pixel) const {
  const Vec2 target = K_inverse_ * (pixel - principal_px_);
  if (!is_distorted_) return Unimaged{target, K_inverse_};
  Vec2 guess = target;
  for (int i = 0; i < kMaxIterations; ++i) {
    const Imaged distorted = distort(guess);
    // A fold of the distortion: beyond it the polynomial means nothing.
    if (cv::determinant(distorted.pixel_by_normalized) <= 0) return std::nullopt;
    const Mat2 inverse = distorted.pixel_by_normalized.inv();
    const Vec2 step = inverse * (target - distorted.pixel);
    if (cv::norm(step) < kTolerance) return Unimaged{guess, inverse * K_inverse_};
    guess += step;
  }
  return std::nullopt;
}

}  // namespace estimation
