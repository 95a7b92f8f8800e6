#include "estimation/radiometry/illumination.h"

#include <algorithm>
#include <cmath>

namespace estimation {
namespace {

double interpolate(ImageView<const float> image, double row, double col) {
  if (!std::isfinite(row)) row = 0.5 * (image.height_px - 1);
  if (!std::isfinite(col)) col = 0.5 * (image.width_px - 1);
  row = std::clamp(row, 0.0, static_cast<double>(image.height_px - 1));
  col = std::clamp(col, 0.0, static_cast<double>(image.width_px - 1));
  const int top = static_cast<int>(row), left = static_cast<int>(col);
  const int bottom = std::min(top + 1, image.height_px - 1);
  const int right = std::min(left + 1, image.width_px - 1);
  const auto at = [&](int r, int c) { return static_cast<double>(image.at(r, c)); };
  return std::lerp(std::lerp(at(top, left), at(top, right), col - left),
                   std::lerp(at(bottom, left), at(bottom, right), col - left), row - top);
}

}  // namespace

double Illumination::at(double column_px, double row_px, double cos_projector,
                        double distance_mm) const {
  double gain = cos_projector;
  if (!vignetting.empty()) gain *= interpolate(vignetting, row_px, column_px);
  if (reference_distance_mm) {
    const double ratio = *reference_distance_mm / distance_mm;
    gain *= ratio * ratio;
  }
  return gain;
}

}  // namespace estimation
