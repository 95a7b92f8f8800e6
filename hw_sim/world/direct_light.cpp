#include "hw_sim/world/direct_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "hw_sim/world/split_picture.h"
#include "hw_sim/world/white_walk.h"

namespace hw_sim {

using estimation::Vec3;

namespace {

// Between pixels light is what falls on their square; none beside the picture.
float between_pixels(estimation::ImageView<const unsigned char> brightness,
                     const LampResponse& lamp, float row_px, float col_px) {
  const int row = static_cast<int>(std::floor(row_px)), col = static_cast<int>(std::floor(col_px));
  const float down = row_px - static_cast<float>(row), right = col_px - static_cast<float>(col);
  const auto at = [&](int r, int c) {
    return lamp.light(brightness.at(std::clamp(r, 0, brightness.height_px - 1),
                                    std::clamp(c, 0, brightness.width_px - 1)));
  };
  return (1 - down) * ((1 - right) * at(row, col) + right * at(row, col + 1)) +
         down * ((1 - right) * at(row + 1, col) + right * at(row + 1, col + 1));
}

bool is_within(float row_px, float col_px, const SplitPicture::Rect& rect) {
  return row_px > static_cast<float>(rect.row_begin) - 0.5F &&
         row_px < static_cast<float>(rect.row_end) - 0.5F &&
         col_px > static_cast<float>(rect.col_begin) - 0.5F &&
         col_px < static_cast<float>(rect.col_end) - 0.5F;
}

}  // namespace

void DirectLight::add_light(estimation::ImageView<const unsigned char> brightness,
                            const LampResponse& lamp, const Vec3& displacement_mm,
                            std::vector<float>& linear) const {
  if (empty()) return;
  const SplitPicture split = split_picture(brightness);
  std::optional<LitLine> line;
  if (split.kind != SplitPicture::Kind::kGeneral) line = lamp.lit(split.line);
  const bool is_columns = split.kind == SplitPicture::Kind::kColumns;
  for (const DirectSample& each : samples_) {
    const float col_px = each.col_px - each.slide.shift_px(0, displacement_mm);
    const float row_px = each.row_px - each.slide.shift_px(1, displacement_mm);
    if (!is_within(row_px, col_px, {0, brightness.height_px, 0, brightness.width_px})) continue;
    const float light = !line || is_within(row_px, col_px, split.rest)
                            ? between_pixels(brightness, lamp, row_px, col_px)
                            : line->at(is_columns ? col_px : row_px, each.blur_px);
    linear[static_cast<std::size_t>(each.sample)] += each.weight * light;
  }
}

double shine(const Vec3& normal, const Vec3& towards_lamp, const Vec3& towards_eye,
             double roughness) {
  const double cos_in = normal.dot(towards_lamp), cos_out = normal.dot(towards_eye);
  if (cos_in <= 0 || cos_out <= 0) return 0;
  const Vec3 sum = towards_lamp + towards_eye;
  const Vec3 half = sum / cv::norm(sum);
  const double alpha2 = roughness * roughness;
  const double cos_half = normal.dot(half);
  const double part = cos_half * cos_half * (alpha2 - 1) + 1;
  const double facets = alpha2 / (std::numbers::pi * part * part);
  // Heitz 2014: height-correlated masking and shadowing over 4 cos cos.
  const auto masked = [&](double a, double b) {
    return a * std::sqrt(alpha2 + (1 - alpha2) * b * b);
  };
  const double visible = 0.5 / (masked(cos_in, cos_out) + masked(cos_out, cos_in));
  return std::numbers::pi * fresnel_reflectance(half.dot(towards_lamp), 1, kSkinIndex) * facets *
         visible;
}

}  // namespace hw_sim
