#include "estimation/report/plot.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace estimation::plot {
namespace {

constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
constexpr int kSubPixelBits = 4;  // of OpenCV's anti-aliased drawing

// Strokes grow with the letters, or large text looks thin and small text blots.
int stroke_px(double scale) { return scale >= 0.8 ? 2 : 1; }

cv::Mat3b viridis_table() {
  cv::Mat1b ramp(1, 256);
  for (int i = 0; i < 256; ++i) ramp(0, i) = static_cast<unsigned char>(i);
  cv::Mat3b table;
  cv::applyColorMap(ramp, table, cv::COLORMAP_VIRIDIS);
  return table;
}

Color color_of(double value, Range range, const cv::Mat3b& table) {
  const double share = (value - range.low) / (range.high - range.low);
  return table(0, static_cast<int>(std::lround(255 * std::clamp(share, 0.0, 1.0))));
}

double tick_step(Range range, int count) {
  const double rough = (range.high - range.low) / std::max(count, 1);
  const double power = std::pow(10, std::floor(std::log10(rough)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (factor * power >= rough * 0.999) return factor * power;
  }
  return 10 * power;
}

cv::Point sub_pixel(cv::Point2d point) {
  constexpr double kUnit = 1 << kSubPixelBits;
  return {static_cast<int>(std::lround(point.x * kUnit)),
          static_cast<int>(std::lround(point.y * kUnit))};
}

}  // namespace

int text_width_px(const std::string& text, double scale) {
  int baseline = 0;
  return cv::getTextSize(text, kFont, scale, stroke_px(scale), &baseline).width;
}

void draw_text(Canvas& canvas, const std::string& text, cv::Point at, double scale, Color color,
               Align align) {
  if (align == Align::kCentre) at.x -= text_width_px(text, scale) / 2;
  if (align == Align::kRight) at.x -= text_width_px(text, scale);
  cv::putText(canvas, text, at, kFont, scale, scalar(color), stroke_px(scale), cv::LINE_AA);
}

void draw_text_upwards(Canvas& canvas, const std::string& text, cv::Point centre, double scale,
                       Color color) {
  const int width = text_width_px(text, scale) + 4;
  const int height = static_cast<int>(std::ceil(32 * scale));
  Canvas flat(height, width, kWhite);
  draw_text(flat, text, {2, static_cast<int>(23 * scale)}, scale, color);
  Canvas upright;
  cv::rotate(flat, upright, cv::ROTATE_90_COUNTERCLOCKWISE);
  paste(upright, {centre.x - height / 2, centre.y - width / 2}, canvas);
}

std::vector<double> nice_ticks(Range range, int count) {
  const double step = tick_step(range, count);
  std::vector<double> ticks;
  const double slack = 1e-9 * (range.high - range.low);
  const double first = std::ceil((range.low - slack) / step);
  const double last = std::floor((range.high + slack) / step);
  const int tick_count = static_cast<int>(last - first) + 1;
  for (int i = 0; i < tick_count; ++i) {
    const double multiple = first + i;
    ticks.push_back(multiple == 0 ? 0.0 : multiple * step);  // never minus zero
  }
  return ticks;
}

std::string tick_label(double value, double step) {
  if (value == 0) return "0";
  const int decimals = std::clamp(static_cast<int>(std::ceil(-std::log10(step) - 1e-9)), 0, 9);
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%.*f", decimals, value);
  return text.data();
}

Range robust_range(const std::vector<ImageView<const float>>& images, double low_share,
                   double high_share) {
  std::vector<float> values;
  for (const auto& image : images) {
    for (int row = 0; row < image.height_px; ++row) {
      for (const float value : image.row(row)) {
        if (std::isfinite(value)) values.push_back(value);
      }
    }
  }
  if (values.empty()) return {};
  const auto quantile = [&](double share) {
    const auto place = values.begin() +
                       static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), place, values.end());
    return double{*place};
  };
  Range range{quantile(low_share), quantile(high_share)};
  const double least = std::max(1e-6, 1e-3 * std::abs(range.high));
  const double margin = std::max(0.03 * (range.high - range.low), least);
  // Quantities that cannot be negative do not get a negative end by the margin.
  range = {range.low >= 0 ? std::max(range.low - margin, 0.0) : range.low - margin,
           range.high + margin};
  return range;
}

double panel_scale(int image_width_px, int image_height_px, int panel_width_px) {
  constexpr int kMostHeights = 2;  // of a panel's width: a line of pixels must not fill gigabytes
  const double scale =
      std::min(static_cast<double>(panel_width_px) / image_width_px,
               static_cast<double>(kMostHeights * panel_width_px) / image_height_px);
  return scale >= 1 ? std::floor(scale) : scale;
}

Image<float> resize_for_panel(ImageView<const float> image, double scale) {
  const int height = std::max(1, static_cast<int>(std::lround(image.height_px * scale)));
  const int width = std::max(1, static_cast<int>(std::lround(image.width_px * scale)));
  Image<float> out(height, width);
  const auto source = [](int i, int size, int source_size) {
    return static_cast<int>(static_cast<std::ptrdiff_t>(i) * source_size / size);
  };
  for (int row = 0; row < height; ++row) {
    const int top = source(row, height, image.height_px);
    const int bottom = std::max(source(row + 1, height, image.height_px), top + 1);
    for (int col = 0; col < width; ++col) {
      const int left = source(col, width, image.width_px);
      const int right = std::max(source(col + 1, width, image.width_px), left + 1);
      double sum = 0, count = 0;
      for (int y = top; y < bottom; ++y) {
        for (int x = left; x < right; ++x) {
          const float value = image.at(y, x);
          if (std::isnan(value)) continue;
          sum += double{value};
          ++count;
        }
      }
      // Half the area or more must be there, or borders would grow.
      const bool is_there = 2 * count >= (bottom - top) * (right - left) && count > 0;
      out.at(row, col) =
          is_there ? static_cast<float>(sum / count) : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return out;
}

Canvas false_color(ImageView<const float> image, Range range) {
  const cv::Mat3b table = viridis_table();
  Canvas canvas(image.height_px, image.width_px);
  for (int row = 0; row < image.height_px; ++row) {
    for (int col = 0; col < image.width_px; ++col) {
      const float value = image.at(row, col);
      canvas(row, col) = std::isnan(value) ? kMissing : color_of(double{value}, range, table);
    }
  }
  return canvas;
}

Canvas color_bar(Range range, const std::string& unit, int height_px) {
  constexpr int kBarWidth = 18, kTickLength = 5;
  constexpr double kScale = 0.45;
  const int tick_count = std::clamp(height_px / 60, 2, 6);
  const std::vector<double> ticks = nice_ticks(range, tick_count);
  const double step = ticks.size() > 1 ? ticks[1] - ticks[0] : range.high - range.low;
  int label_width = 0;
  for (const double tick : ticks) {
    label_width = std::max(label_width, text_width_px(tick_label(tick, step), kScale));
  }
  const int unit_left = kBarWidth + kTickLength + 5 + label_width + 8;
  Canvas canvas(height_px, unit_left + 20, kWhite);
  const cv::Mat3b table = viridis_table();
  for (int y = 0; y < height_px; ++y) {
    const double value = range.high - (range.high - range.low) * (y + 0.5) / height_px;
    canvas(cv::Rect(0, y, kBarWidth, 1)).setTo(scalar(color_of(value, range, table)));
  }
  cv::rectangle(canvas, {0, 0, kBarWidth, height_px}, scalar(kFaintInk));
  for (const double tick : ticks) {
    const int y = static_cast<int>(
        std::lround((range.high - tick) / (range.high - range.low) * (height_px - 1)));
    cv::line(canvas, {kBarWidth, y}, {kBarWidth + kTickLength - 1, y}, scalar(kInk));
    const int baseline = std::clamp(y + 5, 11, height_px - 2);
    draw_text(canvas, tick_label(tick, step), {kBarWidth + kTickLength + 5, baseline}, kScale,
              kInk);
  }
  draw_text_upwards(canvas, unit, {unit_left + 9, height_px / 2}, kScale, kInk);
  return canvas;
}

void paste(const Canvas& from, cv::Point top_left, Canvas& to) {
  const cv::Rect place = cv::Rect(top_left, from.size()) & cv::Rect(0, 0, to.cols, to.rows);
  if (place.empty()) return;
  from(cv::Rect(place.tl() - top_left, place.size())).copyTo(to(place));
}

cv::Point2d Axes::to_px(cv::Point2d point) const {
  return {area_.x + (point.x - x_.low) / (x_.high - x_.low) * area_.width,
          area_.y + (y_.high - point.y) / (y_.high - y_.low) * area_.height};
}

void Axes::draw(Canvas& canvas, const std::string& x_label, const std::string& y_label) const {
  constexpr double kScale = 0.42;
  const std::vector<double> x_ticks = nice_ticks(x_, std::clamp(area_.width / 80, 2, 8));
  const std::vector<double> y_ticks = nice_ticks(y_, std::clamp(area_.height / 50, 2, 6));
  const auto step = [](const std::vector<double>& ticks) {
    return ticks.size() > 1 ? ticks[1] - ticks[0] : 1.0;
  };
  for (const double tick : x_ticks) {
    const int x = static_cast<int>(std::lround(to_px({tick, y_.low}).x));
    cv::line(canvas, {x, area_.y}, {x, area_.br().y}, scalar(kGrid));
    draw_text(canvas, tick_label(tick, step(x_ticks)), {x, area_.br().y + 17}, kScale, kInk,
              Align::kCentre);
  }
  int widest = 0;
  for (const double tick : y_ticks) {
    const int y = static_cast<int>(std::lround(to_px({x_.low, tick}).y));
    cv::line(canvas, {area_.x, y}, {area_.br().x, y}, scalar(kGrid));
    const std::string label = tick_label(tick, step(y_ticks));
    widest = std::max(widest, text_width_px(label, kScale));
    draw_text(canvas, label, {area_.x - 7, y + 5}, kScale, kInk, Align::kRight);
  }
  cv::rectangle(canvas, area_.tl(), area_.br(), scalar(kFaintInk));
  draw_text(canvas, x_label, {area_.x + area_.width / 2, area_.br().y + 38}, kScale, kInk,
            Align::kCentre);
  draw_text_upwards(canvas, y_label, {area_.x - 20 - widest, area_.y + area_.height / 2}, kScale,
                    kInk);
}

void Axes::line(Canvas& canvas, const std::vector<cv::Point2d>& points, Color color) const {
  std::vector<cv::Point> px;
  px.reserve(points.size());
  for (const cv::Point2d& point : points) px.push_back(sub_pixel(to_px(point)));
  cv::polylines(canvas, px, false, scalar(color), 2, cv::LINE_AA, kSubPixelBits);
}

void Axes::dots(Canvas& canvas, const std::vector<cv::Point2d>& points, Color color) const {
  // A white rim sets a dot off from the line it lies on.
  constexpr double kRimRadius = 3.7, kRadius = 3.1;
  const auto disc = [&](cv::Point2d point, double radius_px, Color fill) {
    cv::circle(canvas, sub_pixel(to_px(point)), static_cast<int>(radius_px * (1 << kSubPixelBits)),
               scalar(fill), cv::FILLED, cv::LINE_AA, kSubPixelBits);
  };
  for (const cv::Point2d& point : points) {
    disc(point, kRimRadius, kWhite);
    disc(point, kRadius, color);
  }
}

}  // namespace estimation::plot
