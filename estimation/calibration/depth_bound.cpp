#include "estimation/calibration/depth_bound.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

constexpr int kColPoints = 7, kRowPoints = 5;

// Steps small against each parameter's effect, large against rounding.
double step_of(int parameter) {
  if (parameter >= kStereoAt + 3) return 1e-2;  // mm
  if (parameter >= kStereoAt) return 1e-5;      // rad
  return parameter % kProjectorAt < 4 ? 1e-1 : 1e-4;
}

struct Sight {
  double row = 0, col = 0;
  ProjectorReading reading;
};

std::optional<double> depth_at(const SharedVector& shared, const CameraInfo& camera,
                               const Sight& sight) {
  const Stereo stereo(calibration_of(shared), camera);
  const auto ray = stereo.ray(sight.row, sight.col);
  if (!ray) return std::nullopt;
  const auto depth = stereo.triangulate(*ray, sight.reading);
  return depth ? std::optional(depth->depth_mm) : std::nullopt;
}

std::optional<SharedVector> depth_derivative(const SharedVector& shared, const CameraInfo& camera,
                                             const Sight& sight) {
  SharedVector derivative;
  for (int i = 0; i < kSharedCount; ++i) {
    SharedVector below = shared, above = shared;
    const double step = step_of(i);
    below(i) -= step;
    above(i) += step;
    const auto low = depth_at(below, camera, sight), high = depth_at(above, camera, sight);
    if (!low || !high) return std::nullopt;
    derivative(i) = (*high - *low) / (2 * step);
  }
  return derivative;
}

}  // namespace

SharedMatrix depth_sensitivity(const Calibration& calibration, const CameraInfo& camera,
                               const ProjectorInfo& projector, double nearest_mm,
                               double farthest_mm) {
  const SharedVector shared = shared_of(calibration);
  const Stereo stereo(calibration, camera);
  SharedMatrix sum = SharedMatrix::zeros();
  int count = 0;
  for (const double depth_mm : {nearest_mm, farthest_mm})
    for (int i = 0; i < kColPoints * kRowPoints; ++i) {
      Sight sight{.row = (i / kColPoints + 0.5) * camera.height_px / kRowPoints,
                  .col = (i % kColPoints + 0.5) * camera.width_px / kColPoints,
                  .reading = {}};
      const auto ray = stereo.ray(sight.row, sight.col);
      if (!ray) continue;
      const auto lit = stereo.project(ray->direction * depth_mm);
      const bool is_lit = lit && lit->pixel[0] >= 0 && lit->pixel[0] < projector.width_px &&
                          lit->pixel[1] >= 0 && lit->pixel[1] < projector.height_px;
      if (!is_lit) continue;
      sight.reading = {lit->pixel[0], 0.01, lit->pixel[1], 0.01};
      const auto derivative = depth_derivative(shared, camera, sight);
      if (!derivative) continue;
      sum += *derivative * derivative->t();
      ++count;
    }
  return count > 0 ? sum * (1.0 / count) : sum;
}

double depth_sd_mm(const SharedMatrix& sensitivity, const SharedMatrix& covariance) {
  double trace = 0;
  for (int i = 0; i < kSharedCount; ++i)
    for (int j = 0; j < kSharedCount; ++j) trace += sensitivity(i, j) * covariance(j, i);
  return std::sqrt(std::max(trace, 0.0));
}

}  // namespace estimation
