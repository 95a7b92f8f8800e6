#include "tests/bench/scene.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

namespace bench {
namespace {

constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
constexpr double kFontHeightPx = 30;  // of the Hershey font at scale 1, as fonts are measured
constexpr int kPngScale = 2;
constexpr int kSubPixelBits = 4;
constexpr double kDashPx = 6;

std::vector<Point> outline(const Mark& mark) {
  const double r = mark.radius_px, x = mark.at.x, y = mark.at.y;
  switch (mark.shape) {
    case MarkShape::kSquare:
      return {{x - 0.9 * r, y - 0.9 * r},
              {x + 0.9 * r, y - 0.9 * r},
              {x + 0.9 * r, y + 0.9 * r},
              {x - 0.9 * r, y + 0.9 * r}};
    case MarkShape::kDiamond:
      return {{x, y - 1.3 * r}, {x + 1.3 * r, y}, {x, y + 1.3 * r}, {x - 1.3 * r, y}};
    case MarkShape::kTriangle:
      return {{x, y - 1.2 * r}, {x + 1.1 * r, y + 0.8 * r}, {x - 1.1 * r, y + 0.8 * r}};
    case MarkShape::kCross:
    case MarkShape::kDisc:
      break;
  }
  return {};
}

std::string number(double value) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.2f", value);
  return text.data();
}

std::string hex(Color color) {
  std::array<char, 8> text{};
  std::snprintf(text.data(), text.size(), "#%02x%02x%02x", color.red, color.green, color.blue);
  return text.data();
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else
      out += c;
  }
  return out;
}

std::string path(const std::vector<Point>& points) {
  std::string text;
  for (const Point& point : points) {
    text.append(text.empty() ? "M" : " L");
    text.append(number(point.x)).append(" ").append(number(point.y));
  }
  return text;
}

class SvgWriter {
 public:
  void operator()(const Stroke& stroke) {
    out_ << "<path d=\"" << path(stroke.points) << "\" fill=\"none\" stroke=\"" << hex(stroke.color)
         << "\" stroke-width=\"" << number(stroke.width_px) << '"'
         << (stroke.is_dashed ? " stroke-dasharray=\"6 4\"" : "") << "/>\n";
  }
  void operator()(const Mark& mark) {
    const std::string style = "fill=\"" + hex(mark.color) + "\" stroke=\"#ffffff\"/>\n";
    if (mark.shape == MarkShape::kDisc) {
      out_ << "<circle cx=\"" << number(mark.at.x) << "\" cy=\"" << number(mark.at.y) << "\" r=\""
           << number(mark.radius_px) << "\" " << style;
    } else if (mark.shape == MarkShape::kCross) {
      const double r = mark.radius_px;
      (*this)(
          Stroke{{{mark.at.x - r, mark.at.y - r}, {mark.at.x + r, mark.at.y + r}}, mark.color, 2});
      (*this)(
          Stroke{{{mark.at.x - r, mark.at.y + r}, {mark.at.x + r, mark.at.y - r}}, mark.color, 2});
    } else {
      out_ << "<path d=\"" << path(outline(mark)) << " Z\" " << style;
    }
  }
  void operator()(const Words& words) {
    static constexpr std::array<const char*, 3> kAnchors{"start", "middle", "end"};
    out_ << "<text x=\"" << number(words.at.x) << "\" y=\"" << number(words.at.y)
         << "\" font-size=\"" << number(words.height_px) << "\" fill=\"" << hex(words.color)
         << "\" text-anchor=\"" << kAnchors[static_cast<std::size_t>(words.anchor)] << '"';
    if (words.is_upwards)
      out_ << " transform=\"rotate(-90 " << number(words.at.x) << ' ' << number(words.at.y)
           << ")\"";
    out_ << '>' << escaped(words.text) << "</text>\n";
  }
  std::string text() const { return out_.str(); }

 private:
  std::ostringstream out_;
};

cv::Scalar scalar(Color color) {
  return {static_cast<double>(color.blue), static_cast<double>(color.green),
          static_cast<double>(color.red)};
}

cv::Point sub_pixel(Point point) {
  constexpr double kUnit = kPngScale * (1 << kSubPixelBits);
  return {static_cast<int>(std::lround(point.x * kUnit)),
          static_cast<int>(std::lround(point.y * kUnit))};
}

class PngWriter {
 public:
  explicit PngWriter(const Scene& scene)
      : canvas_(static_cast<int>(scene.height_px * kPngScale),
                static_cast<int>(scene.width_px * kPngScale), cv::Vec3b(255, 255, 255)) {}

  void operator()(const Stroke& stroke) {
    for (std::size_t i = 1; i < stroke.points.size(); ++i)
      segment(stroke.points[i - 1], stroke.points[i], stroke);
  }
  void operator()(const Mark& mark) {
    if (mark.shape == MarkShape::kDisc) {
      disc(mark.at, mark.radius_px + 0.6, kWhite);
      disc(mark.at, mark.radius_px, mark.color);
    } else if (mark.shape == MarkShape::kCross) {
      const double r = mark.radius_px;
      (*this)(
          Stroke{{{mark.at.x - r, mark.at.y - r}, {mark.at.x + r, mark.at.y + r}}, mark.color, 2});
      (*this)(
          Stroke{{{mark.at.x - r, mark.at.y + r}, {mark.at.x + r, mark.at.y - r}}, mark.color, 2});
    } else {
      std::vector<cv::Point> corners;
      for (const Point& point : outline(mark)) corners.push_back(sub_pixel(point));
      cv::fillPoly(canvas_, std::vector<std::vector<cv::Point>>{corners}, scalar(mark.color),
                   cv::LINE_AA, kSubPixelBits);
    }
  }
  void operator()(const Words& words) {
    const double scale = kPngScale * words.height_px / kFontHeightPx;
    const int stroke_px = scale > 0.95 ? 2 : 1;
    const double width = words_width_px(words.text, words.height_px) * kPngScale;
    const double shift = words.anchor == Anchor::kStart    ? 0
                         : words.anchor == Anchor::kMiddle ? -0.5 * width
                                                           : -width;
    const double x = words.at.x * kPngScale, y = words.at.y * kPngScale;
    if (!words.is_upwards) {
      cv::putText(canvas_, words.text,
                  {static_cast<int>(std::lround(x + shift)), static_cast<int>(std::lround(y))},
                  kFont, scale, scalar(words.color), stroke_px, cv::LINE_AA);
      return;
    }
    const int height = static_cast<int>(std::ceil(1.4 * kPngScale * words.height_px));
    const int baseline = static_cast<int>(kPngScale * words.height_px);
    cv::Mat3b flat(height, static_cast<int>(std::ceil(width)) + 4, cv::Vec3b(255, 255, 255));
    cv::putText(flat, words.text, {2, baseline}, kFont, scale, scalar(words.color), stroke_px,
                cv::LINE_AA);
    cv::Mat3b upright;
    cv::rotate(flat, upright, cv::ROTATE_90_COUNTERCLOCKWISE);
    const cv::Rect wanted(static_cast<int>(x) - baseline, static_cast<int>(y - shift - width) - 2,
                          upright.cols, upright.rows);
    const cv::Rect place = wanted & cv::Rect(0, 0, canvas_.cols, canvas_.rows);
    if (!place.empty())
      upright(cv::Rect(place.tl() - wanted.tl(), place.size())).copyTo(canvas_(place));
  }
  const cv::Mat3b& canvas() const { return canvas_; }

 private:
  void disc(Point at, double radius_px, Color color) {
    cv::circle(canvas_, sub_pixel(at),
               static_cast<int>(radius_px * kPngScale * (1 << kSubPixelBits)), scalar(color),
               cv::FILLED, cv::LINE_AA, kSubPixelBits);
  }
  void solid(Point from, Point to, const Stroke& stroke) {
    cv::line(canvas_, sub_pixel(from), sub_pixel(to), scalar(stroke.color),
             std::max(1, static_cast<int>(std::lround(stroke.width_px * kPngScale))), cv::LINE_AA,
             kSubPixelBits);
  }
  void segment(Point from, Point to, const Stroke& stroke) {
    const double length = std::hypot(to.x - from.x, to.y - from.y);
    if (!stroke.is_dashed || length == 0) return solid(from, to, stroke);
    const Point step{(to.x - from.x) / length, (to.y - from.y) / length};
    for (double at = 0; at < length; at += 1.7 * kDashPx) {
      const double end = std::min(at + kDashPx, length);
      solid({from.x + at * step.x, from.y + at * step.y},
            {from.x + end * step.x, from.y + end * step.y}, stroke);
    }
  }

  cv::Mat3b canvas_;
};

}  // namespace

double words_width_px(const std::string& text, double height_px) {
  const double scale = kPngScale * height_px / kFontHeightPx;
  int baseline = 0;
  return cv::getTextSize(text, kFont, scale, 1, &baseline).width / static_cast<double>(kPngScale);
}

std::string svg(const Scene& scene) {
  SvgWriter writer;
  for (const Item& item : scene.items) std::visit(writer, item);
  std::string text = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 ";
  text.append(number(scene.width_px)).append(" ").append(number(scene.height_px));
  text.append("\" font-family=\"Helvetica, Arial, sans-serif\">\n");
  text.append("<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n");
  return text.append(writer.text()).append("</svg>\n");
}

std::vector<unsigned char> png(const Scene& scene) {
  PngWriter writer(scene);
  for (const Item& item : scene.items) std::visit(writer, item);
  std::vector<unsigned char> bytes;
  cv::imencode(".png", writer.canvas(), bytes);
  return bytes;
}

}  // namespace bench
