#include "estimation/calibration/standard_target.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace estimation {
namespace {

constexpr double kPlaneTrim = 3;  // standard deviations beyond which a point is not the plane's
constexpr double kLeastPlaneSdMm = 0.02;

double quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// Through the points, those off it trimmed away round by round.
std::optional<Plane> fit_plane(const std::vector<Vec3>& points) {
  std::vector<char> use(points.size(), 1);
  Plane plane;
  for (int round = 0; round < 6; ++round) {
    Vec3 mean;
    double count = 0;
    for (std::size_t i = 0; i < points.size(); ++i)
      if (use[i]) {
        mean += points[i];
        ++count;
      }
    if (count < 50) return std::nullopt;
    mean /= count;
    Mat3 scatter = Mat3::zeros();
    for (std::size_t i = 0; i < points.size(); ++i)
      if (use[i]) scatter += (points[i] - mean) * (points[i] - mean).t();
    cv::Matx31d values;
    Mat3 vectors;
    cv::eigen(scatter, values, vectors);
    plane.normal = Vec3(vectors(2, 0), vectors(2, 1), vectors(2, 2));
    if (plane.normal.dot(mean) > 0) plane.normal = -plane.normal;
    plane.offset_mm = plane.normal.dot(mean);
    plane.rms_mm = std::sqrt(std::max(values(2), 0.0) / count);
    const double limit_mm = kPlaneTrim * std::max(plane.rms_mm, kLeastPlaneSdMm);
    for (std::size_t i = 0; i < points.size(); ++i)
      use[i] = std::abs(plane.normal.dot(points[i]) - plane.offset_mm) < limit_mm;
  }
  return plane;
}

Vec3 point_at(const StandardView& view, int row, int col) {
  return {static_cast<double>(view.position_mm[0].at(row, col)),
          static_cast<double>(view.position_mm[1].at(row, col)),
          static_cast<double>(view.position_mm[2].at(row, col))};
}

cv::Mat1b bright_pixels(const StandardView& view, const Sampler& sampler, double least_frac) {
  std::array<std::vector<double>, 3> levels;
  const auto for_each = [&](const auto& use) {
    for (int row = 0; row < view.white.height_px; ++row)
      for (int col = 0; col < view.white.width_px; ++col) {
        if (!std::isfinite(view.position_mm[2].at(row, col))) continue;
        sampler.for_each_band(row, col, [&](int band, int channel) {
          const auto value = static_cast<double>(view.white.at(row, col, channel));
          if (std::isfinite(value)) use(row, col, static_cast<std::size_t>(band), value);
        });
      }
  };
  for_each([&](int, int, std::size_t band, double value) { levels[band].push_back(value); });
  std::array<double, 3> least{};
  for (std::size_t band = 0; band < 3; ++band)
    if (!levels[band].empty()) least[band] = least_frac * quantile(levels[band], 0.95);
  cv::Mat1b mask(view.white.height_px, view.white.width_px, uchar{0});
  for_each([&](int row, int col, std::size_t band, double value) {
    if (value > least[band]) mask(row, col) = 255;
  });
  return mask;
}

}  // namespace

std::optional<Target> find_target(const StandardView& view, const Sampler& sampler, double focal_px,
                                  const StandardOptions& options) {
  Target target{{}, bright_pixels(view, sampler, options.least_level_frac)};
  std::vector<Vec3> points;
  for (int row = 0; row < target.mask.rows; ++row)
    for (int col = 0; col < target.mask.cols; ++col)
      if (target.mask(row, col)) points.push_back(point_at(view, row, col));
  const auto plane = fit_plane(points);
  if (!plane) return std::nullopt;
  target.plane = *plane;
  const double limit_mm = 2 * kPlaneTrim * std::max(plane->rms_mm, kLeastPlaneSdMm);
  double depth_mm = 0, count = 0;
  for (int row = 0; row < target.mask.rows; ++row)
    for (int col = 0; col < target.mask.cols; ++col) {
      if (!target.mask(row, col)) continue;
      const Vec3 point = point_at(view, row, col);
      const double off_mm = std::abs(plane->normal.dot(point) - plane->offset_mm);
      if (off_mm > limit_mm) target.mask(row, col) = 0;
      depth_mm += point[2];
      ++count;
    }
  // Single pixels that failed are no border.
  const cv::Mat near = cv::getStructuringElement(cv::MORPH_RECT, {5, 5});
  cv::Mat1b closed, inner;
  cv::morphologyEx(target.mask, closed, cv::MORPH_CLOSE, near);
  const int border_px = static_cast<int>(options.border_mm * focal_px * count / depth_mm);
  const int size_px = 2 * border_px + 1;
  cv::erode(closed, inner, cv::getStructuringElement(cv::MORPH_RECT, {size_px, size_px}), {-1, -1},
            1, cv::BORDER_CONSTANT, cv::Scalar(255));
  cv::bitwise_and(target.mask, inner, target.mask);
  return target;
}

}  // namespace estimation
