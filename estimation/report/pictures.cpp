#include "estimation/report/pictures.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "estimation/base/check.h"

namespace estimation::plot {
namespace {

constexpr int kMargin = 16;
constexpr int kTitleHeight = 46;
constexpr int kCaptionHeight = 24;
constexpr int kPanelWidth = 588;  // of one of three; a small image is enlarged by whole factors
constexpr double kTitleScale = 0.7;
constexpr double kTextScale = 0.48;

const std::array<std::string, 3> kBandNames{"red", "green", "blue"};
// Readable on white, in the canvas' order.
const std::array<Color, 3> kBandColors{Color{45, 45, 205}, Color{60, 150, 40}, Color{200, 95, 30}};

Color band_color(int band, int band_count) {
  return band_count == 1 ? kInk : kBandColors[static_cast<std::size_t>(band)];
}

std::vector<ImageView<const float>> views_of(const BandMaps& bands, int band_count) {
  std::vector<ImageView<const float>> views;
  views.reserve(static_cast<std::size_t>(band_count));
  for (int band = 0; band < band_count; ++band) {
    views.push_back(bands[static_cast<std::size_t>(band)].view());
  }
  return views;
}

std::string median_text(ImageView<const float> image) {
  std::vector<float> values;
  for (int row = 0; row < image.height_px; ++row) {
    for (const float value : image.row(row)) {
      if (!std::isnan(value)) values.push_back(value);
    }
  }
  if (values.empty()) return "no estimate";
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  std::array<char, 48> text{};
  std::snprintf(text.data(), text.size(), "median %.4g", double{*middle});
  return text.data();
}

// Panels side by side under a title, captions below them, the colour bar (may be empty) at the end.
Canvas compose(const std::string& title, const std::vector<Canvas>& panels,
               const std::vector<std::string>& captions, const Canvas& bar) {
  int width = kMargin;
  for (const Canvas& panel : panels) width += panel.cols + kMargin;
  if (!bar.empty()) width += bar.cols + kMargin;
  width = std::max(width, text_width_px(title, kTitleScale) + 2 * kMargin);
  const int height = kTitleHeight + panels.front().rows + kCaptionHeight + kMargin / 2;
  Canvas canvas(height, width, kWhite);
  draw_text(canvas, title, {kMargin, 31}, kTitleScale, kInk);
  int x = kMargin;
  for (std::size_t i = 0; i < panels.size(); ++i) {
    paste(panels[i], {x, kTitleHeight}, canvas);
    const int baseline = kTitleHeight + panels[i].rows + 18;
    draw_text(canvas, captions[i], {x + panels[i].cols / 2, baseline}, kTextScale, kInk,
              Align::kCentre);
    x += panels[i].cols + kMargin;
  }
  if (!bar.empty()) paste(bar, {x, kTitleHeight}, canvas);
  return canvas;
}

Canvas resize_picture(const Canvas& picture, double scale) {
  Canvas out;
  const cv::Size size(std::max(1, static_cast<int>(std::lround(picture.cols * scale))),
                      std::max(1, static_cast<int>(std::lround(picture.rows * scale))));
  cv::resize(picture, out, size, 0, 0, scale > 1 ? cv::INTER_NEAREST : cv::INTER_AREA);
  return out;
}

// --- validity -----------------------------------------------------------------------------------

struct Meaning {
  std::uint32_t bit;
  const char* text;
  Color color;
};

// Gravest first: a pixel is painted by the first of its bits.
const std::array<Meaning, 13> kMeanings{{
    {kBackground, "background", {90, 90, 90}},
    {kSaturated, "saturated", {60, 60, 220}},
    {kTooDark, "too dark", {45, 20, 20}},
    {kNoCorrespondence, "no correspondence", {170, 60, 150}},
    {kGrazingProjector, "grazing projector", {200, 130, 60}},
    {kGrazingCamera, "grazing camera", {200, 180, 90}},
    {kOutsideModel, "outside the model", {50, 120, 240}},
    {kNotIdentifiable, "not identifiable", {90, 190, 250}},
    {kPoorFit, "poor fit", {150, 170, 250}},
    {kNearDiscontinuity, "near a discontinuity", {215, 225, 150}},
    {kIndirectFixedAtZero, "indirect fixed at zero", {205, 200, 235}},
    {kHelpedByNeighbourhood, "helped by neighbours", {190, 230, 250}},
    {kEdited, "edited", {235, 205, 235}},
}};
const Color kFine{185, 215, 190};

Color color_of(std::uint32_t validity) {
  for (const Meaning& meaning : kMeanings) {
    if (validity & meaning.bit) return meaning.color;
  }
  return kFine;
}

Image<std::uint32_t> any_band(const std::array<Image<std::uint32_t>, 3>& validity, int band_count) {
  Image<std::uint32_t> all = validity[0];
  for (int band = 1; band < band_count; ++band) {
    const auto samples = validity[static_cast<std::size_t>(band)].samples();
    for (std::size_t i = 0; i < samples.size(); ++i) all.samples()[i] |= samples[i];
  }
  return all;
}

std::string share_text(std::size_t count, std::size_t total) {
  const double share = 100.0 * static_cast<double>(count) / static_cast<double>(total);
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), share < 10 ? "%.1f%%" : "%.0f%%", share);
  return text.data();
}

struct LegendEntry {
  std::string text, share;
  Color color;
};

// What occurs, with the share of all pixels that have it; fine pixels first.
std::vector<LegendEntry> legend_of(const Image<std::uint32_t>& validity) {
  const auto samples = validity.samples();
  const auto count_of = [&](auto&& has) {
    return static_cast<std::size_t>(std::count_if(samples.begin(), samples.end(), has));
  };
  std::vector<LegendEntry> entries;
  const std::size_t fine = count_of([](std::uint32_t value) { return value == 0; });
  entries.push_back({"nothing to report", share_text(fine, samples.size()), kFine});
  for (const Meaning& meaning : kMeanings) {
    const std::size_t count =
        count_of([&](std::uint32_t value) { return (value & meaning.bit) != 0; });
    if (count == 0) continue;
    entries.push_back({meaning.text, share_text(count, samples.size()), meaning.color});
  }
  return entries;
}

Canvas draw_legend(const std::vector<LegendEntry>& entries, int least_height_px) {
  constexpr int kLine = 22, kBox = 13;
  int text_width = 0;
  for (const LegendEntry& entry : entries) {
    text_width = std::max(text_width, text_width_px(entry.text, kTextScale));
  }
  const int height = std::max(least_height_px, kLine * static_cast<int>(entries.size()));
  Canvas canvas(height, kBox + 8 + text_width + 70, kWhite);
  int y = 0;
  for (const LegendEntry& entry : entries) {
    const cv::Rect box(0, y + 3, kBox, kBox);
    canvas(box).setTo(scalar(entry.color));
    cv::rectangle(canvas, box, scalar(kFaintInk));
    draw_text(canvas, entry.text, {kBox + 8, y + 15}, kTextScale, kInk);
    draw_text(canvas, entry.share, {canvas.cols - 2, y + 15}, kTextScale, kFaintInk, Align::kRight);
    y += kLine;
  }
  return canvas;
}

// --- profiles -----------------------------------------------------------------------------------

// Each band about the peak of its own site, in -period/2 .. period/2, by rising shift.
std::vector<cv::Point2d> centred(const std::vector<ProfileSample>& samples, double peak_px,
                                 double period_px) {
  std::vector<cv::Point2d> points;
  points.reserve(samples.size());
  for (const ProfileSample& sample : samples)
    points.push_back({std::remainder(sample.shift_px - peak_px, period_px), sample.reflectance});
  std::sort(points.begin(), points.end(),
            [](const cv::Point2d& a, const cv::Point2d& b) { return a.x < b.x; });
  return points;
}

double largest_value(std::span<const ProfilePoint> points) {
  double largest = 0;
  for (const ProfilePoint& point : points)
    for (const ProfileBand& band : point.bands)
      for (const auto* samples : {&band.measured, &band.matched})
        for (const ProfileSample& sample : *samples)
          largest = std::max(largest, sample.reflectance);
  return largest > 0 ? largest : 1;
}

// What the matched curve stands for; nothing if there is none.
void draw_material(const ProfileBand& band, Color color, cv::Point right_end, Canvas& canvas) {
  constexpr double kScale = 0.42;
  if (band.matched.empty()) return;
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "R_d %.3f   l_d %.2f mm", band.diffuse_reflectance,
                band.translucency_mm);
  const int width = text_width_px(text.data(), kScale);
  canvas(cv::Rect(right_end.x - width - 4, right_end.y - 13, width + 8, 19)).setTo(scalar(kWhite));
  draw_text(canvas, text.data(), right_end, kScale, color, Align::kRight);
}

void draw_profile(const ProfilePoint& point, int band_count, double largest, cv::Rect place,
                  Canvas& canvas) {
  const cv::Rect area(place.x + 76, place.y + 34, place.width - 92, place.height - 86);
  const double half = point.period_px / 2;
  // A little room below zero: the noise of dark samples goes there.
  const Axes axes(area, {-half, half}, {-0.04 * largest, 1.08 * largest});
  axes.draw(canvas, "stripe shift from the peak [projector px]", "reflectance factor");
  for (int b = 0; b < band_count; ++b)
    draw_material(point.bands[static_cast<std::size_t>(b)], band_color(b, band_count),
                  {area.br().x - 10, area.y + 22 + 20 * b}, canvas);
  // All lines first: no band's dots are hidden below another's line.
  for (const bool is_line : {true, false})
    for (int b = 0; b < band_count; ++b) {
      const ProfileBand& band = point.bands[static_cast<std::size_t>(b)];
      const Color color = band_color(b, band_count);
      if (is_line)
        axes.line(canvas, centred(band.matched, band.peak_px, point.period_px), color);
      else
        axes.dots(canvas, centred(band.measured, band.peak_px, point.period_px), color);
    }
  draw_text(canvas, "row " + std::to_string(point.row) + ", column " + std::to_string(point.col),
            {area.x, place.y + 24}, 0.52, kInk);
}

bool has_curve(const ProfilePoint& point) {
  return std::any_of(point.bands.begin(), point.bands.end(),
                     [](const ProfileBand& band) { return !band.matched.empty(); });
}

void draw_profile_legend(std::span<const ProfilePoint> points, int band_count, cv::Point right_end,
                         Canvas& canvas) {
  int x = right_end.x;
  const auto entry = [&](const std::string& text, const auto& symbol) {
    x -= text_width_px(text, kTextScale);
    draw_text(canvas, text, {x, right_end.y}, kTextScale, kInk);
    x -= 28;
    symbol(cv::Point(x, right_end.y - 5));
    x -= 14;
  };
  if (std::any_of(points.begin(), points.end(), has_curve))
    entry("matched", [&](cv::Point at) {
      cv::line(canvas, at, at + cv::Point(20, 0), scalar(kInk), 2, cv::LINE_AA);
    });
  entry("measured", [&](cv::Point at) {
    cv::circle(canvas, at + cv::Point(13, 0), 3, scalar(kInk), cv::FILLED, cv::LINE_AA);
  });
  for (int band = band_count - 1; band >= 0 && band_count > 1; --band)
    entry(kBandNames[static_cast<std::size_t>(band)], [&](cv::Point at) {
      cv::rectangle(canvas, cv::Rect(at + cv::Point(6, -6), cv::Size(13, 13)),
                    scalar(band_color(band, band_count)), cv::FILLED);
    });
}

// --- frames -------------------------------------------------------------------------------------

// OpenCV names a mosaic by the second row's second and third pixel: its BG is our RG.
int bayer_conversion(const CameraInfo& camera) {
  const int first = band_at(camera, 0, 0);
  if (first == 0) return cv::COLOR_BayerBG2BGR;
  if (first == 2) return cv::COLOR_BayerRG2BGR;
  return band_at(camera, 0, 1) == 0 ? cv::COLOR_BayerGB2BGR : cv::COLOR_BayerGR2BGR;
}

// Linear, 0 black to 1 white.
cv::Mat3f color_frame(ImageView<const std::uint16_t> dn, const CameraInfo& camera) {
  cv::Mat color;
  const int type = dn.channel_count == 3 ? CV_16UC3 : CV_16UC1;
  cv::Mat samples(dn.height_px, dn.width_px, type);
  for (int row = 0; row < dn.height_px; ++row) {
    std::copy(dn.row(row).begin(), dn.row(row).end(), samples.ptr<std::uint16_t>(row));
  }
  const ColorFilter filter = camera.pixel_format.filter;
  const int conversion = filter == ColorFilter::kRgb    ? int{cv::COLOR_RGB2BGR}
                         : filter == ColorFilter::kMono ? int{cv::COLOR_GRAY2BGR}
                                                        : bayer_conversion(camera);
  cv::cvtColor(samples, color, conversion);
  const double full_dn = std::ldexp(1.0, camera.pixel_format.bit_depth) - 1;
  const double black_dn = camera.black_level_dn.value_or(0);
  const double scale = 1 / (camera.saturation_level_dn.value_or(full_dn) - black_dn);
  cv::Mat3f linear;
  color.convertTo(linear, CV_32FC3, scale, -black_dn * scale);
  return linear;
}

}  // namespace

Canvas draw_bands(const std::string& title, const std::string& unit, const BandMaps& bands,
                  int band_count) {
  const auto views = views_of(bands, band_count);
  const Range range = robust_range(views, 0.01, 0.99);
  const double scale = panel_scale(views[0].width_px, views[0].height_px, kPanelWidth);
  std::vector<Canvas> panels;
  std::vector<std::string> captions;
  for (std::size_t band = 0; band < views.size(); ++band) {
    panels.push_back(false_color(resize_for_panel(views[band], scale).view(), range));
    captions.push_back((band_count == 1 ? "" : kBandNames[band] + ", ") + median_text(views[band]));
  }
  return compose(title, panels, captions, color_bar(range, unit, panels[0].rows));
}

Canvas draw_depth(const Image<float>& depth_mm) {
  const Range range = robust_range({depth_mm.view()}, 0.005, 0.995);
  const double scale = panel_scale(depth_mm.width_px(), depth_mm.height_px(), kPanelWidth);
  const Canvas panel = false_color(resize_for_panel(depth_mm.view(), scale).view(), range);
  return compose("depth from the camera", {panel}, {median_text(depth_mm.view()) + " mm"},
                 color_bar(range, "mm", panel.rows));
}

Canvas draw_normals(const std::array<Image<float>, 3>& normal) {
  const int height = normal[0].height_px(), width = normal[0].width_px();
  Canvas picture(height, width);
  const auto level = [](float value) {
    return cv::saturate_cast<unsigned char>(127.5F * (1 + value));
  };
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      const float x = normal[0].at(row, col), y = normal[1].at(row, col);
      const float z = normal[2].at(row, col);
      // Up is green and towards the camera is blue, as in normal maps; camera y is down, z away.
      picture(row, col) = std::isnan(x) ? kMissing : Color{level(-z), level(-y), level(x)};
    }
  }
  const double scale = panel_scale(width, height, kPanelWidth);
  return compose("normal", {resize_picture(picture, scale)},
                 {"red: right, green: up, blue: towards the camera"}, {});
}

Canvas draw_validity(const std::array<Image<std::uint32_t>, 3>& validity, int band_count) {
  const Image<std::uint32_t> all = any_band(validity, band_count);
  Canvas picture(all.height_px(), all.width_px());
  for (int row = 0; row < all.height_px(); ++row) {
    for (int col = 0; col < all.width_px(); ++col) picture(row, col) = color_of(all.at(row, col));
  }
  const Canvas panel =
      resize_picture(picture, panel_scale(picture.cols, picture.rows, kPanelWidth));
  const Canvas legend = draw_legend(legend_of(all), panel.rows);
  // A picture lower than its legend is continued in white.
  Canvas padded(legend.rows, panel.cols, kWhite);
  paste(panel, {0, 0}, padded);
  return compose("validity", {padded}, {band_count > 1 ? "any band" : ""}, legend);
}

Canvas draw_profiles(std::span<const ProfilePoint> points, int band_count) {
  constexpr int kWidth = 640, kHeight = 390;
  const auto shown = points.first(std::min<std::size_t>(points.size(), 4));
  const int columns = shown.size() > 1 ? 2 : 1;
  const int rows = shown.size() > 2 ? 2 : 1;
  Canvas canvas(kTitleHeight + rows * kHeight + 4, columns * kWidth + kMargin, kWhite);
  draw_text(canvas, "scattering profiles", {kMargin, 31}, kTitleScale, kInk);
  draw_profile_legend(shown, band_count, {canvas.cols - kMargin, 30}, canvas);
  const double largest = largest_value(shown);
  for (std::size_t i = 0; i < shown.size(); ++i) {
    const int column = static_cast<int>(i) % 2, row = static_cast<int>(i) / 2;
    draw_profile(shown[i], band_count, largest,
                 {column * kWidth, kTitleHeight + row * kHeight, kWidth, kHeight}, canvas);
  }
  return canvas;
}

Canvas draw_frame(const QuicklookFrame& frame, const CameraInfo& camera) {
  check(frame.dn.height_px == camera.height_px && frame.dn.width_px == camera.width_px,
        "a frame of another size than the camera's");
  cv::Mat3f linear = color_frame(frame.dn, camera);
  cv::max(linear, 0, linear);
  cv::Mat3f display;
  cv::pow(linear, 1 / 2.2, display);
  Canvas picture;
  display.convertTo(picture, CV_8UC3, 255);
  const double scale = panel_scale(picture.cols, picture.rows, 2 * kPanelWidth);
  return compose(frame.title, {resize_picture(picture, scale)}, {""}, {});
}

}  // namespace estimation::plot
