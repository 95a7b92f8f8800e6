#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/bench/geometry_bench.h"

namespace bench {
namespace {

constexpr float kFullScalePx = 0.3F;
constexpr int kTitleRows = 24;

// Blue, white, red; BGR.
cv::Vec3b color_of(float error_px) {
  if (std::isnan(error_px)) return {120, 120, 120};
  const float share = std::clamp(error_px / kFullScalePx, -1.0F, 1.0F);
  const auto faded = static_cast<unsigned char>(std::lround(255 * (1 - std::abs(share))));
  return share < 0 ? cv::Vec3b(255, faded, faded) : cv::Vec3b(faded, faded, 255);
}

}  // namespace

bool write_error_picture(const std::filesystem::path& file, const GeometryTruth& truth,
                         const std::vector<ColumnErrors>& panels) {
  const int height = truth.maps.height_px, width = truth.maps.width_px;
  cv::Mat3b picture(height + kTitleRows, width * static_cast<int>(panels.size()), {0, 0, 0});
  for (std::size_t panel = 0; panel < panels.size(); ++panel) {
    const int left = static_cast<int>(panel) * width;
    cv::putText(picture, panels[panel].title, {left + 8, 17}, cv::FONT_HERSHEY_SIMPLEX, 0.5,
                {255, 255, 255}, 1, cv::LINE_AA);
    for (int row = 0; row < height; ++row)
      for (int col = 0; col < width; ++col) {
        if (!truth.is_judged.at(row, col)) continue;
        const float error_px = panels[panel].maps->correspondence_px[0].at(row, col) -
                               truth.maps.correspondence_px[0].at(row, col);
        picture(row + kTitleRows, left + col) = color_of(error_px);
      }
  }
  return cv::imwrite(file.string(), picture);
}

}  // namespace bench
