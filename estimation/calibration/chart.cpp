#include "estimation/calibration/chart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

constexpr int kWidthPx = 760, kHeightPx = 480;

plot::Range padded(double low, double high) {
  if (!(high > low)) {
    const double half = std::max(std::abs(low) / 2, 1e-9);
    return {low - half, high + half};
  }
  return {low - 0.05 * (high - low), high + 0.05 * (high - low)};
}

struct Ranges {
  plot::Range x, y;
};

Ranges ranges_of(const Chart& chart) {
  constexpr double kFar = std::numeric_limits<double>::infinity();
  double x_low = kFar, x_high = -kFar, y_low = kFar, y_high = -kFar;
  for (const ChartSeries& series : chart.series)
    for (const cv::Point2d& point : series.points) {
      if (!std::isfinite(point.x) || !std::isfinite(point.y)) continue;
      x_low = std::min(x_low, point.x);
      x_high = std::max(x_high, point.x);
      y_low = std::min(y_low, point.y);
      y_high = std::max(y_high, point.y);
    }
  if (x_low > x_high) return {{0, 1}, {0, 1}};
  if (chart.starts_at_zero && y_low >= 0) {
    const double high = y_high > 0 ? 1.08 * y_high : 1;
    return {padded(x_low, x_high), {0, high}};
  }
  return {padded(x_low, x_high), padded(y_low, y_high)};
}

}  // namespace

plot::Color band_color(int band) {
  return std::array{kRedInk, kGreenInk, kBlueInk}[static_cast<std::size_t>(band)];
}

plot::Canvas draw_chart(const Chart& chart) {
  plot::Canvas canvas(kHeightPx, kWidthPx, plot::kWhite);
  plot::draw_text(canvas, chart.title, {90, 30}, 0.6, plot::kInk);
  int legend_px = 90;
  for (const ChartSeries& series : chart.series) {
    if (series.name.empty()) continue;
    cv::Mat swatch = canvas(cv::Rect(legend_px, 46, 12, 12));
    swatch.setTo(plot::scalar(series.color));
    plot::draw_text(canvas, series.name, {legend_px + 18, 57}, 0.42, plot::kInk);
    legend_px += 40 + plot::text_width_px(series.name, 0.42);
  }
  const Ranges ranges = ranges_of(chart);
  const plot::Axes axes({90, 75, kWidthPx - 120, kHeightPx - 130}, ranges.x, ranges.y);
  axes.draw(canvas, chart.x_label, chart.y_label);
  for (const ChartSeries& series : chart.series)
    if (series.is_line) axes.line(canvas, series.points, series.color);
  for (const ChartSeries& series : chart.series)
    if (!series.is_line) axes.dots(canvas, series.points, series.color);
  return canvas;
}

Result<void> save_picture(const std::filesystem::path& folder, const std::string& file,
                          const plot::Canvas& canvas) {
  std::error_code problem;
  std::filesystem::create_directories(folder, problem);
  if (problem)
    return tl::unexpected(InputError{InputFault::kUnwritable, folder.string(), "",
                                     "cannot make the report's folder: " + problem.message()});
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".png", canvas, bytes))
    return tl::unexpected(InputError{InputFault::kInvalid, (folder / file).string(), "",
                                     "the picture could not be encoded as PNG"});
  const auto* first = reinterpret_cast<const std::byte*>(bytes.data());
  return write_file_atomically(folder / file, {first, first + bytes.size()});
}

}  // namespace estimation
