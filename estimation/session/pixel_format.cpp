#include <array>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/session/manifest.h"

namespace estimation {
namespace {

constexpr std::array<std::pair<ColorFilter, std::string_view>, 6> kFilterNames{{
    {ColorFilter::kMono, "Mono"},
    {ColorFilter::kBayerRG, "BayerRG"},
    {ColorFilter::kBayerGR, "BayerGR"},
    {ColorFilter::kBayerGB, "BayerGB"},
    {ColorFilter::kBayerBG, "BayerBG"},
    {ColorFilter::kRgb, "RGB"},
}};

// The bands of the 2 x 2 tile at the sensor's pixel (0, 0), row-major; 0 R, 1 G, 2 B.
std::array<int, 4> tile(ColorFilter filter) {
  switch (filter) {
    case ColorFilter::kBayerRG:
      return {0, 1, 1, 2};
    case ColorFilter::kBayerGR:
      return {1, 0, 2, 1};
    case ColorFilter::kBayerGB:
      return {1, 2, 0, 1};
    case ColorFilter::kBayerBG:
      return {2, 1, 1, 0};
    case ColorFilter::kMono:
    case ColorFilter::kRgb:
      break;
  }
  return {0, 0, 0, 0};
}

}  // namespace

std::optional<PixelFormat> parse_pixel_format(std::string_view name) {
  for (const auto& [filter, filter_name] : kFilterNames) {
    if (!name.starts_with(filter_name)) continue;
    const std::string_view depth = name.substr(filter_name.size());
    if (depth == "8") return PixelFormat{filter, 8};
    if (depth == "12" && filter != ColorFilter::kRgb) return PixelFormat{filter, 12};
    if (depth == "16") return PixelFormat{filter, 16};
  }
  return std::nullopt;
}

std::string to_string(PixelFormat format) {
  for (const auto& [filter, name] : kFilterNames) {
    if (filter == format.filter) return std::string(name) + std::to_string(format.bit_depth);
  }
  check(false, "a color filter without a name");
  return {};
}

int band_at(const CameraInfo& camera, int row, int col, int channel) {
  const ColorFilter filter = camera.pixel_format.filter;
  if (filter == ColorFilter::kRgb) return channel;
  const bool is_odd_row = ((row + camera.roi_y_px) & 1) != 0;
  const bool is_odd_col = ((col + camera.roi_x_px) & 1) != 0;
  return tile(filter)[(is_odd_row ? 2U : 0U) + (is_odd_col ? 1U : 0U)];
}

}  // namespace estimation
