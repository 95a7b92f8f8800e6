// A small plotting kit on OpenCV's drawing: canvases, text, nice ticks, colour bars, axes. Private
// to this folder and to calibration's charts: the pictures it makes leave as PNG bytes.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "estimation/base/image.h"

namespace estimation::plot {

using Canvas = cv::Mat3b;  // blue, green, red
using Color = cv::Vec3b;

inline const Color kWhite{255, 255, 255};
inline const Color kInk{40, 40, 40};
inline const Color kFaintInk{120, 120, 120};
inline const Color kGrid{225, 225, 225};
inline const Color kMissing{190, 190, 190};  // no estimate

inline cv::Scalar scalar(Color color) {
  return {double(color[0]), double(color[1]), double(color[2])};
}

enum class Align { kLeft, kCentre, kRight };

// Text with its baseline at `at`. Height of a capital letter about 21 px times `scale`.
void draw_text(Canvas& canvas, const std::string& text, cv::Point at, double scale, Color color,
               Align align = Align::kLeft);
int text_width_px(const std::string& text, double scale);
// Turned to read upwards, centred on `centre`.
void draw_text_upwards(Canvas& canvas, const std::string& text, cv::Point centre, double scale,
                       Color color);

struct Range {
  double low = 0, high = 1;
};

// Round values of 1, 2 or 5 times a power of ten within the range, about `count` of them.
std::vector<double> nice_ticks(Range range, int count);
// With as many decimals as the tick step needs; "0" has none.
std::string tick_label(double value, double step);

// From the `low_share` to the `high_share` quantile of the finite values of all images, widened a
// little; 0..1 if there are none.
Range robust_range(const std::vector<ImageView<const float>>& images, double low_share,
                   double high_share);

// How many times the picture is enlarged (above 1, whole) or reduced for a panel of
// `panel_width_px`, and of twice that height at most.
double panel_scale(int image_width_px, int image_height_px, int panel_width_px);

// Resized so that pixels stay sharp when enlarged, and are averaged (NaN left out) when reduced.
Image<float> resize_for_panel(ImageView<const float> image, double scale);

// Viridis from low to high, kMissing for NaN.
Canvas false_color(ImageView<const float> image, Range range);

// A vertical bar of the same colours with ticks, labels and the unit, `height_px` tall.
Canvas color_bar(Range range, const std::string& unit, int height_px);

void paste(const Canvas& from, cv::Point top_left, Canvas& to);

// The plotting area of a curve: maps data to px and draws frame, grid, ticks and labels.
class Axes {
 public:
  Axes(cv::Rect area, Range x, Range y) : area_(area), x_(x), y_(y) {}
  void draw(Canvas& canvas, const std::string& x_label, const std::string& y_label) const;
  void line(Canvas& canvas, const std::vector<cv::Point2d>& points, Color color) const;
  void dots(Canvas& canvas, const std::vector<cv::Point2d>& points, Color color) const;

 private:
  cv::Point2d to_px(cv::Point2d point) const;

  cv::Rect area_;
  Range x_, y_;
};

}  // namespace estimation::plot
