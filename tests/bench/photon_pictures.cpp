// Windows as pictures: how they look under stripes by both ways, where the ways differ, and what
// that does to sigma_a.
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/bench/photon_tables.h"

namespace bench {

namespace {

constexpr int kZoom = 7;  // picture px a camera pixel
constexpr int kHeaderPx = 22;
constexpr std::size_t kShownShift = 6;
constexpr double kLevelScale = 0.10, kSigmaScale = 0.50;  // where the colours end

using Value = std::function<double(std::size_t pixel)>;  // NaN: nothing to show

// A band's value at each camera pixel: the mean of its sites within a pixel, NaN without any.
cv::Mat1d spread(const Window& window, int band, const Value& value) {
  cv::Mat1d sum(window.plan.height_px, window.plan.width_px, 0.0), count = sum.clone();
  for (std::size_t i = 0; i < window.pixels.size(); ++i) {
    const WindowPixel& pixel = window.pixels[i];
    const double v = value(i);
    if (pixel.band != band || std::isnan(v)) continue;
    for (int row = std::max(pixel.row - 1, 0); row <= std::min(pixel.row + 1, sum.rows - 1); ++row)
      for (int col = std::max(pixel.col - 1, 0); col <= std::min(pixel.col + 1, sum.cols - 1);
           ++col) {
        sum(row, col) += v;
        count(row, col) += 1;
      }
  }
  cv::Mat1d mean;
  cv::divide(sum, count, mean);  // 0 / 0 is NaN
  return mean;
}

cv::Vec3b diverging(double share) {  // -1 blue, 0 white, 1 red; grey for NaN
  if (std::isnan(share)) return {128, 128, 128};
  const double t = std::clamp(share, -1.0, 1.0), fade = 255 * (1 - std::abs(t));
  const auto faded = static_cast<unsigned char>(fade);
  return t < 0 ? cv::Vec3b(255, faded, faded) : cv::Vec3b(faded, faded, 255);
}

cv::Mat3b titled(const cv::Mat3b& small, const std::string& title) {
  cv::Mat3b large;
  cv::resize(small, large, {}, kZoom, kZoom, cv::INTER_NEAREST);
  cv::copyMakeBorder(large, large, kHeaderPx, 4, 2, 2, cv::BORDER_CONSTANT, {255, 255, 255});
  cv::putText(large, title, {4, kHeaderPx - 6}, cv::FONT_HERSHEY_SIMPLEX, 0.36, {0, 0, 0}, 1,
              cv::LINE_AA);
  return large;
}

cv::Mat3b difference_panel(const Window& window, int band, double scale, const std::string& title,
                           const Value& value) {
  const cv::Mat1d map = spread(window, band, value);
  cv::Mat3b panel(map.size());
  for (int row = 0; row < map.rows; ++row)
    for (int col = 0; col < map.cols; ++col) panel(row, col) = diverging(map(row, col) / scale);
  return titled(panel, title);
}

cv::Mat3b stripes_panel(const Window& window, const Signals& signals, const std::string& title) {
  cv::Mat3b panel(window.plan.height_px, window.plan.width_px, cv::Vec3b(0, 0, 0));
  for (int band = 0; band < 3; ++band) {
    const cv::Mat1d map =
        spread(window, band, [&](std::size_t i) { return signals[kShownShift][i]; });
    for (int row = 0; row < map.rows; ++row)
      for (int col = 0; col < map.cols; ++col) {
        const double v = std::isnan(map(row, col)) ? 0 : map(row, col);
        // Display gamma; 0.35 of a white surface is as bright as it gets.
        panel(row, col)[2 - band] =
            static_cast<unsigned char>(255 * std::pow(std::clamp(v / 0.35, 0.0, 1.0), 1 / 2.2));
      }
  }
  return titled(panel, title);
}

cv::Mat3b sheet_of(const WindowResult& result) {
  const Window& window = result.window;
  const char* bands[] = {"red", "green", "blue"};
  std::vector<cv::Mat> upper = {stripes_panel(
                           window, window.photons,
                           std::string(window.plan.name).append(": photons, stripes"))},
                       lower = {stripes_panel(window, window.surface, "surface way")};
  for (int band = 0; band < 3; ++band) {
    upper.push_back(difference_panel(window, band, kLevelScale,
                                     std::string(bands[band]).append(": surface - photons, +-10%"),
                                     [&](std::size_t i) { return result.profiles[i].level; }));
    lower.push_back(difference_panel(
        window, band, kSigmaScale, std::string(bands[band]).append(": sigma_a, photons, +-50%"),
        [&](std::size_t i) {
          const Recovered& r = result.from_photons[i];
          return r.is_valid ? r.sigma_a_per_mm / window.pixels[i].scattering.sigma_a_per_mm - 1
                            : std::numeric_limits<double>::quiet_NaN();
        }));
  }
  cv::Mat rows[2], sheet;
  cv::hconcat(upper, rows[0]);
  cv::hconcat(lower, rows[1]);
  cv::vconcat(rows[0], rows[1], sheet);
  return sheet;
}

void write(Report& report, const std::filesystem::path& file, const cv::Mat& picture) {
  if (!cv::imwrite(file.string(), picture))
    report.fail(std::string("cannot write ").append(file.string()));
}

}  // namespace

void write_picture(Report& report, const WindowResult& result,
                   const std::filesystem::path& folder) {
  const std::string name =
      std::string("photon_window_").append(result.window.plan.name).append(".png");
  write(report, folder / name, sheet_of(result));
}

void write_sheet(Report& report, const std::vector<WindowResult>& results,
                 const std::filesystem::path& folder) {
  if (results.empty()) return;
  std::vector<cv::Mat> sheets;
  int width = 0;
  for (const WindowResult& result : results) {
    sheets.push_back(sheet_of(result));
    width = std::max(width, sheets.back().cols);
  }
  for (cv::Mat& sheet : sheets)
    cv::copyMakeBorder(sheet, sheet, 0, 8, 0, width - sheet.cols, cv::BORDER_CONSTANT,
                       {255, 255, 255});
  cv::Mat all;
  cv::vconcat(sheets, all);
  write(report, folder / "photon_windows.png", all);
}

}  // namespace bench
