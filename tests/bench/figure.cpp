#include "tests/bench/figure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>

namespace bench {
namespace {

constexpr double kLeftPx = 74, kRightPx = 18, kTopPx = 40, kBottomPx = 54;
constexpr double kTextPx = 12, kTitlePx = 14, kLegendRowPx = 20;

struct Rect {
  double left = 0, top = 0, right = 0, bottom = 0;
  bool overlaps(const Rect& other) const {
    return left < other.right && other.left < right && top < other.bottom && other.top < bottom;
  }
};

std::string text_of(double value) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.6g", value);
  return text.data();
}

// One axis: data to 0..1, and where its ticks are.
class Scale {
 public:
  Scale(const Axis& axis, std::vector<double> values) : is_log_(axis.is_log) {
    std::erase_if(values, [&](double v) { return !std::isfinite(v) || (is_log_ && v <= 0); });
    double low = is_log_ ? 0.1 : 0, high = 1;
    if (!values.empty()) {
      low = *std::min_element(values.begin(), values.end());
      high = *std::max_element(values.begin(), values.end());
    }
    low_ = mapped(axis.low.value_or(low));
    high_ = mapped(axis.high.value_or(high));
    const double margin = std::max(0.06 * (high_ - low_), is_log_ ? 0.04 : 1e-12);
    if (!axis.low) low_ -= margin;
    if (!axis.high) high_ += margin;
  }

  double place(double value) const {
    if (is_log_ && value <= 0) return std::numeric_limits<double>::quiet_NaN();
    return (mapped(value) - low_) / (high_ - low_);
  }

  struct Tick {
    double value = 0;
    bool has_label = true;
  };
  std::vector<Tick> ticks() const { return is_log_ ? log_ticks() : linear_ticks(); }

 private:
  double mapped(double value) const { return is_log_ ? std::log10(value) : value; }

  std::vector<Tick> log_ticks() const {
    const double decades = high_ - low_;
    const int every = decades > 8 ? static_cast<int>(std::ceil(decades / 7)) : 1;
    std::vector<Tick> ticks;
    for (int power = static_cast<int>(std::floor(low_)); power <= std::ceil(high_); ++power)
      for (int digit = 1; digit < 10; ++digit) {
        const double value = digit * std::pow(10.0, power);
        const double at = std::log10(value);
        if (at < low_ - 1e-9 || at > high_ + 1e-9) continue;
        if (decades > 5 && digit != 1) continue;
        const bool has_label =
            digit == 1 ? power % every == 0 : decades < 2.5 && (digit == 2 || digit == 5);
        ticks.push_back({value, has_label});
      }
    return ticks;
  }
  std::vector<Tick> linear_ticks() const {
    const double rough = (high_ - low_) / 6;
    const double power = std::pow(10, std::floor(std::log10(rough)));
    double step = 10 * power;
    for (const double factor : {5.0, 2.0, 1.0})
      if (factor * power >= rough * 0.999) step = factor * power;
    std::vector<Tick> ticks;
    const int first = static_cast<int>(std::ceil(low_ / step - 1e-9));
    const int last = static_cast<int>(std::floor(high_ / step + 1e-9));
    for (int i = first; i <= last; ++i) ticks.push_back({i * step, true});
    return ticks;
  }

  bool is_log_;
  double low_ = 0, high_ = 1;
};

// One panel's drawing area and what has been placed in it.
class Panel {
 public:
  Panel(const Figure& figure, Rect area, Scene& scene)
      : figure_(figure),
        area_(area),
        scene_(scene),
        x_(figure.x, coordinates(
                         figure, [](const Point& p) { return p.x; }, false)),
        y_(figure.y, coordinates(
                         figure, [](const Point& p) { return p.y; }, true)) {}

  void draw() {
    draw_axes();
    draw_levels();
    for (const Series& series : figure_.series) draw_line(series);
    for (const Series& series : figure_.series) draw_marks(series);
    draw_level_labels();
    for (const Series& series : figure_.series) draw_labels(series);
  }

 private:
  template <typename Get>
  static std::vector<double> coordinates(const Figure& figure, Get get, bool is_vertical) {
    std::vector<double> values;
    for (const Series& series : figure.series)
      for (const Point& point : series.points) values.push_back(get(point));
    if (is_vertical)
      for (const Level& level : figure.levels) values.push_back(level.y);
    return values;
  }

  Point to_px(Point data) const {
    return {area_.left + x_.place(data.x) * (area_.right - area_.left),
            area_.bottom - y_.place(data.y) * (area_.bottom - area_.top)};
  }
  bool is_inside(Point px) const {
    return px.x >= area_.left - 0.5 && px.x <= area_.right + 0.5 && px.y >= area_.top - 0.5 &&
           px.y <= area_.bottom + 0.5;
  }

  void draw_axes() {
    double widest = 0;
    for (const auto& tick : x_.ticks()) {
      const double x = area_.left + x_.place(tick.value) * (area_.right - area_.left);
      scene_.items.push_back(
          Stroke{{{x, area_.top}, {x, area_.bottom}}, kGrid, tick.has_label ? 1 : 0.5});
      if (tick.has_label)
        scene_.items.push_back(
            Words{text_of(tick.value), {x, area_.bottom + 16}, kTextPx, kInk, Anchor::kMiddle});
    }
    for (const auto& tick : y_.ticks()) {
      const double y = area_.bottom - y_.place(tick.value) * (area_.bottom - area_.top);
      scene_.items.push_back(
          Stroke{{{area_.left, y}, {area_.right, y}}, kGrid, tick.has_label ? 1 : 0.5});
      if (!tick.has_label) continue;
      scene_.items.push_back(
          Words{text_of(tick.value), {area_.left - 6, y + 4}, kTextPx, kInk, Anchor::kEnd});
      widest = std::max(widest, words_width_px(text_of(tick.value), kTextPx));
    }
    scene_.items.push_back(Stroke{{{area_.left, area_.top},
                                   {area_.right, area_.top},
                                   {area_.right, area_.bottom},
                                   {area_.left, area_.bottom},
                                   {area_.left, area_.top}},
                                  kFaintInk});
    const double middle = 0.5 * (area_.left + area_.right);
    scene_.items.push_back(
        Words{figure_.title, {middle, area_.top - 14}, kTitlePx, kInk, Anchor::kMiddle});
    scene_.items.push_back(
        Words{figure_.x.label, {middle, area_.bottom + 38}, kTextPx, kInk, Anchor::kMiddle});
    scene_.items.push_back(Words{figure_.y.label,
                                 {area_.left - 16 - widest, 0.5 * (area_.top + area_.bottom)},
                                 kTextPx,
                                 kInk,
                                 Anchor::kMiddle,
                                 true});
  }

  void draw_levels() {
    for (const Level& level : figure_.levels) {
      const double y = area_.bottom - y_.place(level.y) * (area_.bottom - area_.top);
      if (!is_inside({area_.left, y})) continue;
      scene_.items.push_back(Stroke{{{area_.left, y}, {area_.right, y}}, level.color, 1.5, true});
      const double width = words_width_px(level.label, kTextPx);
      taken_.push_back({area_.left + 5, y - 5 - kTextPx, area_.left + 5 + width, y});
      taken_.push_back({area_.left, y - 2, area_.right, y + 2});
    }
  }

  // Over the points, which may be anywhere, on a ground of their own.
  void draw_level_labels() {
    for (const Level& level : figure_.levels) {
      const double y = area_.bottom - y_.place(level.y) * (area_.bottom - area_.top);
      if (!is_inside({area_.left, y}) || level.label.empty()) continue;
      const double middle = y - 4 - 0.5 * kTextPx, width = words_width_px(level.label, kTextPx);
      scene_.items.push_back(
          Stroke{{{area_.left + 12, middle}, {area_.left + width, middle}}, kWhite, kTextPx + 4});
      scene_.items.push_back(Words{level.label, {area_.left + 5, y - 5}, kTextPx, level.color});
    }
  }

  void draw_line(const Series& series) {
    if (!series.is_joined) return;
    Stroke stroke{{}, series.color, 1.6};
    for (const Point& point : series.points) {
      const Point px = to_px(point);
      if (is_inside(px)) stroke.points.push_back(px);
    }
    scene_.items.push_back(stroke);
  }

  void draw_marks(const Series& series) {
    if (!series.has_marks) return;
    for (const Point& point : series.points) {
      const Point px = to_px(point);
      if (!is_inside(px)) continue;
      scene_.items.push_back(Mark{px, series.shape, 4.2, series.color});
      taken_.push_back({px.x - 5, px.y - 5, px.x + 5, px.y + 5});
    }
  }

  // Beside its point where nothing else is, nearest first; farther away with a thin leader.
  void draw_labels(const Series& series) {
    for (std::size_t i = 0; i < series.labels.size() && i < series.points.size(); ++i) {
      const Point px = to_px(series.points[i]);
      if (series.labels[i].empty() || !is_inside(px)) continue;
      const double width = words_width_px(series.labels[i], 11);
      for (const double distance : {9.0, 18.0, 30.0, 45.0, 62.0, 80.0}) {
        bool is_placed = false;
        for (const double angle : {0.0, 3.14159, -0.6, 0.6, 2.54, -2.54, -1.57, 1.57, -1.1, 1.1}) {
          const Point to{px.x + distance * std::cos(angle), px.y + distance * std::sin(angle)};
          const double left = std::cos(angle) > 0.1    ? to.x
                              : std::cos(angle) < -0.1 ? to.x - width
                                                       : to.x - 0.5 * width;
          const Rect box{left, to.y - 6, left + width, to.y + 6};
          if (!is_free(box)) continue;
          if (distance > 20) scene_.items.push_back(Stroke{{px, to}, kFaintInk, 0.6});
          scene_.items.push_back(Words{series.labels[i], {left, to.y + 4}, 11, series.color});
          taken_.push_back(box);
          is_placed = true;
          break;
        }
        if (is_placed) break;
      }
    }
  }
  bool is_free(const Rect& box) const {
    if (box.left < area_.left + 2 || box.right > area_.right - 2 || box.top < area_.top + 2 ||
        box.bottom > area_.bottom - 2)
      return false;
    return std::none_of(taken_.begin(), taken_.end(),
                        [&](const Rect& other) { return box.overlaps(other); });
  }

  const Figure& figure_;
  Rect area_;
  Scene& scene_;
  Scale x_, y_;
  std::vector<Rect> taken_;
};

// Names of all panels, each once, in rows below the panels.
void draw_legend(const std::vector<Figure>& panels, double top, Scene& scene) {
  std::vector<const Series*> entries;
  for (const Figure& figure : panels)
    for (const Series& series : figure.series) {
      const bool is_known = std::any_of(entries.begin(), entries.end(), [&](const Series* known) {
        return known->name == series.name;
      });
      if (!series.name.empty() && !is_known) entries.push_back(&series);
    }
  double x = kLeftPx, y = top + 12;
  for (const Series* series : entries) {
    const double width = 34 + words_width_px(series->name, kTextPx);
    if (x > kLeftPx && x + width > scene.width_px - kRightPx) {
      x = kLeftPx;
      y += kLegendRowPx;
    }
    if (series->is_joined)
      scene.items.push_back(Stroke{{{x - 2, y - 4}, {x + 14, y - 4}}, series->color, 1.6});
    if (series->has_marks)
      scene.items.push_back(Mark{{x + 6, y - 4}, series->shape, 4.2, series->color});
    scene.items.push_back(Words{series->name, {x + 18, y}, kTextPx, kInk});
    x += width;
  }
  scene.height_px = y + 14;
}

}  // namespace

Scene draw(const std::vector<Figure>& panels, double panel_width_px, double panel_height_px) {
  Scene scene{.width_px = panel_width_px * static_cast<double>(panels.size()),
              .height_px = panel_height_px,
              .items = {}};
  double left = 0;
  for (const Figure& figure : panels) {
    const Rect area{left + kLeftPx, kTopPx, left + panel_width_px - kRightPx,
                    panel_height_px - kBottomPx};
    Panel(figure, area, scene).draw();
    left += panel_width_px;
  }
  draw_legend(panels, panel_height_px, scene);
  return scene;
}

}  // namespace bench
