#include "hw_sim/world/board_sight.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "hw_sim/world/board_light.h"
#include "hw_sim/world/optics.h"

namespace hw_sim {

using estimation::Calibration;
using estimation::CameraInfo;
using estimation::Image;
using estimation::Vec3;

namespace {

// A pixel's reflectance is the mean over so many places of it, squared; an edge that runs along the
// pixels is placed to a 256th of one where it crosses them.
constexpr int kParts = 4, kEdgeParts = 16;
constexpr int kFineOfBlurred = 3;  // with a place in the pixel's middle

// How much a vignetted lens passes at a place of its picture.
double passes(double lost_frac, double col_px, double row_px, int width_px, int height_px) {
  const double col = 2 * col_px / (width_px - 1) - 1, row = 2 * row_px / (height_px - 1) - 1;
  const double width2 = std::pow(width_px - 1, 2), height2 = std::pow(height_px - 1, 2);
  const double radius2 = (width2 * col * col + height2 * row * row) / (width2 + height2);
  return std::max(0.0, 1 - lost_frac * radius2);
}

struct Patch {
  double mean = 0;
  bool is_even = true;
};

// Of a pixel whose corners are these places of the target: [row][col].
Patch sampled_reflectance(const Target& target, const std::array<cv::Vec2d, 4>& corners,
                          int parts) {
  Patch patch;
  double first = 0;
  for (int i = 0; i < parts * parts; ++i) {
    // In rows and columns of their own: an edge along a row crosses all of them, not a whole row of
    // them at once.
    const int down = i / parts, across = i % parts;
    const double x = (across + (down + 0.5) / parts) / parts;
    const double y = (down + (across + 0.5) / parts) / parts;
    const cv::Vec2d at = (1 - y) * ((1 - x) * corners[0] + x * corners[1]) +
                         y * ((1 - x) * corners[2] + x * corners[3]);
    const double reflectance = target.reflectance_at(at[0], at[1]);
    if (i == 0) first = reflectance;
    patch.is_even = patch.is_even && reflectance == first;
    patch.mean += reflectance / (parts * parts);
  }
  return patch;
}

}  // namespace

// Rays of the lattice's places, integers being their middles.
struct TargetSight::View {
  const CameraInfo& camera;
  const Calibration& calibration;
  int fine;
  Pinhole eye, lamp;
  estimation::Mat3 rotation;
  Vec3 middle_mm, normal;

  View(const CameraInfo& camera_info, const Calibration& c, const Target& target, int fine_count)
      : camera(camera_info),
        calibration(c),
        fine(fine_count),
        eye(c.camera, estimation::Mat3::eye(), {0, 0, 0}),
        lamp(c.projector, c.projector_from_camera, c.projector_from_camera_mm),
        rotation(target.rotation()),
        middle_mm(target.middle_mm),
        normal(-(rotation * Vec3(0, 0, 1))) {}

  double camera_px(double place) const { return (place + 0.5) / fine - 0.5; }
  Vec3 meet(double col, double row) const {
    const Vec3 ray =
        eye.ray(camera_px(col) + camera.roi_x_px, camera_px(row) + camera.roi_y_px).direction;
    return ray * (normal.dot(middle_mm) / normal.dot(ray));
  }
};

TargetSight::TargetSight(const CameraInfo& camera, const estimation::ProjectorInfo& projector,
                         const Calibration& calibration, const Target& target,
                         const Effects& effects)
    : target_(target),
      effects_(effects),
      projector_width_px_(projector.width_px),
      projector_height_px_(projector.height_px),
      fine_(effects.camera_blurs() ? kFineOfBlurred : 1),
      width_(fine_ * camera.width_px),
      height_(fine_ * camera.height_px) {
  look(View(camera, calibration, target, fine_));
}

std::size_t TargetSight::at(int row, int col) const {
  return static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) +
         static_cast<std::size_t>(col);
}

double TargetSight::projector_row_px(int row, int col) const {
  return static_cast<double>(row_px_[at(row * fine_ + fine_ / 2, col * fine_ + fine_ / 2)]);
}

std::vector<cv::Vec2d> TargetSight::corners_mm(const View& view) const {
  const std::size_t stride = static_cast<std::size_t>(width_) + 1;
  std::vector<cv::Vec2d> corners(stride * static_cast<std::size_t>(height_ + 1));
  tbb::parallel_for(0, height_ + 1, [&](int row) {
    for (int col = 0; col <= width_; ++col) {
      const Vec3 own = view.rotation.t() * (view.meet(col - 0.5, row - 0.5) - view.middle_mm);
      corners[static_cast<std::size_t>(row) * stride + static_cast<std::size_t>(col)] = {own[0],
                                                                                         own[1]};
    }
  });
  return corners;
}

double TargetSight::reflectance(const std::array<cv::Vec2d, 4>& corners) const {
  const Patch patch = sampled_reflectance(target_, corners, kParts);
  return patch.is_even ? patch.mean : sampled_reflectance(target_, corners, kEdgeParts).mean;
}

void TargetSight::look(const View& view) {
  const std::vector<cv::Vec2d> corners = corners_mm(view);
  for (auto* values : {&column_px_, &row_px_, &blur_px_, &px_per_mm_, &share_})
    values->assign(at(height_, 0), 0.0F);
  const CameraInfo& camera = view.camera;
  Image<float> ambient(height_, width_), camera_blur_px(height_, width_);
  tbb::parallel_for(0, height_, [&](int row) {
    for (int col = 0; col < width_; ++col) {
      const std::size_t i = at(row, col);
      const std::size_t above = i + static_cast<std::size_t>(row);  // corners have one more a row
      const std::size_t below = above + static_cast<std::size_t>(width_) + 1;
      const Vec3 point = view.meet(col, row), towards = view.lamp.center_mm() - point;
      const double distance_mm = cv::norm(towards);
      const ProjectedPoint lit = view.lamp.project(point);
      const double seen =
          reflectance({corners[above], corners[above + 1], corners[below], corners[below + 1]}) *
          passes(effects_.camera_vignetting_frac, view.camera_px(col), view.camera_px(row),
                 camera.width_px, camera.height_px);
      column_px_[i] = static_cast<float>(lit.col_px);
      row_px_[i] = static_cast<float>(lit.row_px);
      blur_px_[i] = static_cast<float>(effects_.blur_at(distance_mm));
      px_per_mm_[i] = static_cast<float>(view.calibration.projector.K(0, 0) / distance_mm);
      share_[i] = static_cast<float>(
          seen * std::max(0.0, towards.dot(view.normal) / distance_mm) *
          std::pow(*view.calibration.irradiance->reference_distance_mm / distance_mm, 2) *
          passes(effects_.vignetting_frac, lit.col_px, lit.row_px, projector_width_px_,
                 projector_height_px_));
      ambient.at(row, col) = static_cast<float>(effects_.ambient_frac * seen);
      camera_blur_px.at(row, col) =
          static_cast<float>(fine_ * effects_.camera_blur_at(cv::norm(point)));
    }
  });
  if (effects_.camera_blurs()) camera_blur_ = CameraBlur(std::move(camera_blur_px), 1);
  ambient_ = on_pixels(std::move(ambient));
}

std::vector<float> TargetSight::spread_light(const Picture& picture) const {
  std::vector<Spread> spreads = target_.spreads;
  double opaque_frac = 1;
  for (const Spread& spread : spreads) opaque_frac -= spread.share_frac;
  spreads.push_back({opaque_frac, 0});
  std::vector<float> light(share_.size(), 0.0F), blur_px(share_.size());
  for (const Spread& spread : spreads) {
    const auto sd_mm = static_cast<float>(spread.sd_mm);
    for (std::size_t i = 0; i < blur_px.size(); ++i)
      blur_px[i] = std::hypot(blur_px_[i], sd_mm * px_per_mm_[i]);
    const auto [least, greatest] = std::minmax_element(blur_px.begin(), blur_px.end());
    const BlurredPicture blurred(picture.brightness, effects_.gamma, static_cast<double>(*least),
                                 static_cast<double>(*greatest));
    tbb::parallel_for(0, height_, [&](int row) {
      for (std::size_t i = at(row, 0); i < at(row + 1, 0); ++i)
        if (share_[i] > 0)
          light[i] +=
              static_cast<float>(spread.share_frac * blurred.at(static_cast<double>(column_px_[i]),
                                                                static_cast<double>(row_px_[i]),
                                                                static_cast<double>(blur_px[i])));
    });
  }
  return light;
}

// Through the lens, then summed by the pixels.
Image<float> TargetSight::on_pixels(Image<float> fine) const {
  camera_blur_.apply(fine);
  if (fine_ == 1) return fine;
  Image<float> pixels(height_ / fine_, width_ / fine_);
  const auto share = 1.0F / static_cast<float>(fine_ * fine_);
  for (int row = 0; row < height_; ++row)
    for (int col = 0; col < width_; ++col)
      pixels.at(row / fine_, col / fine_) += share * fine.at(row, col);
  return pixels;
}

Image<float> TargetSight::lit(const Picture& picture) const {
  const std::vector<float> pattern = spread_light(picture);
  Image<float> light(height_, width_);
  for (std::size_t i = 0; i < pattern.size(); ++i) {
    const auto column = static_cast<double>(column_px_[i]), line = static_cast<double>(row_px_[i]);
    const bool is_in_beam = column > -0.5 && line > -0.5 && column < projector_width_px_ - 0.5 &&
                            line < projector_height_px_ - 0.5;
    const double black = is_in_beam ? effects_.black_frac : 0;
    light.samples()[i] = share_[i] * (pattern[i] + static_cast<float>(black));
  }
  return on_pixels(std::move(light));
}

}  // namespace hw_sim
