#include "estimation/geometry/support.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace estimation {
namespace {

constexpr int kRadiusPx = 3;
constexpr int kMinSupportCount = 4;
// What noise and a colour's own bias may add between neighbours, projector px.
constexpr float kSlackPx = 1.5F;
// A slanted surface may change this many times faster than the median one.
constexpr float kSlopeFactor = 3;
constexpr float kMinSlope = 0.3F;

// Median change between horizontal neighbours and between vertical ones, whichever is larger.
float typical_slope(ImageView<const float> position_px) {
  std::vector<float> across, down;
  for (int row = 0; row + 1 < position_px.height_px; ++row) {
    for (int col = row % 3; col + 1 < position_px.width_px; col += 3) {
      const float here = position_px.at(row, col);
      const float dx = std::abs(position_px.at(row, col + 1) - here);
      const float dy = std::abs(position_px.at(row + 1, col) - here);
      if (!std::isnan(dx)) across.push_back(dx);
      if (!std::isnan(dy)) down.push_back(dy);
    }
  }
  const auto median = [](std::vector<float>& values) {
    if (values.empty()) return 0.0F;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  };
  return std::max({median(across), median(down), kMinSlope});
}

void count_neighbours(ImageView<const float> position_px, int row, float slope,
                      std::vector<float>& decoded, std::vector<float>& close) {
  const int width = position_px.width_px;
  decoded.assign(static_cast<std::size_t>(width), 0);
  close.assign(static_cast<std::size_t>(width), 0);
  const float* own = position_px.row(row).data();
  for (int dy = -kRadiusPx; dy <= kRadiusPx; ++dy) {
    if (row + dy < 0 || row + dy >= position_px.height_px) continue;
    const float* other = position_px.row(row + dy).data();
    for (int dx = -kRadiusPx; dx <= kRadiusPx; ++dx) {
      if (dx == 0 && dy == 0) continue;
      const auto distance = static_cast<float>(std::max(std::abs(dx), std::abs(dy)));
      const float tolerance_px = kSlackPx + kSlopeFactor * slope * distance;
      const int last = std::min(width, width - dx);
      for (int col = std::max(0, -dx); col < last; ++col) {
        const float there = other[col + dx];
        decoded[static_cast<std::size_t>(col)] += there == there ? 1.0F : 0.0F;
        close[static_cast<std::size_t>(col)] +=
            std::abs(there - own[col]) <= tolerance_px ? 1.0F : 0.0F;
      }
    }
  }
}

}  // namespace

Image<unsigned char> find_supported(ImageView<const float> position_px, double min_support_frac) {
  Image<unsigned char> supported(position_px.height_px, position_px.width_px);
  const float slope = typical_slope(position_px);
  const auto frac = static_cast<float>(min_support_frac);
  const auto rows = oneapi::tbb::blocked_range<int>(0, position_px.height_px, 16);
  oneapi::tbb::parallel_for(rows, [&](const oneapi::tbb::blocked_range<int>& range) {
    std::vector<float> decoded, close;
    for (int row = range.begin(); row < range.end(); ++row) {
      count_neighbours(position_px, row, slope, decoded, close);
      const auto out = supported.view().row(row);
      for (std::size_t col = 0; col < out.size(); ++col) {
        out[col] = close[col] >= std::max(frac * decoded[col], float{kMinSupportCount}) ? 1 : 0;
      }
    }
  });
  return supported;
}

}  // namespace estimation
