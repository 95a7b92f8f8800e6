#include "estimation/refine/lit_patches.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <optional>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr float kFarAway = 1e6F;
// Depth per sideways mm between neighbours from which the surface is broken, as SurfaceOptions'.
constexpr double kMaxSlope = 4;

double at(ImageView<const float> image, int row, int col) {
  return static_cast<double>(image.at(row, col));
}

bool is_inside(const LitSurface& surface, int row, int col) {
  return row >= 0 && col >= 0 && row < surface.height_px() && col < surface.width_px();
}

// How position and stripes' coordinate change from pixel to pixel.
struct Change {
  Vec3 position_mm{0, 0, 0};
  double position_px = 0;
};

// One step from (row, col) if the surface goes on there.
std::optional<Change> step(const LitSurface& surface, int row, int col, int by_row, int by_col) {
  const int r = row + by_row, c = col + by_col;
  if (!is_inside(surface, r, c) || !surface.is_lit(r, c) || !goes_on(surface, row, col, r, c))
    return std::nullopt;
  return Change{surface.position(r, c) - surface.position(row, col),
                at(surface.position_px, r, c) - at(surface.position_px, row, col)};
}

// Per pixel in one direction: both neighbours' mean, or the one there is.
std::optional<Change> change(const LitSurface& surface, int row, int col, int by_row, int by_col) {
  const auto ahead = step(surface, row, col, by_row, by_col);
  const auto behind = step(surface, row, col, -by_row, -by_col);
  if (ahead && behind)
    return Change{(ahead->position_mm - behind->position_mm) / 2.0,
                  (ahead->position_px - behind->position_px) / 2};
  if (ahead) return ahead;
  if (behind) return Change{-behind->position_mm, -behind->position_px};
  return std::nullopt;
}

// Irradiance times area of a pixel's piece of the surface.
double piece_flux_mm2(const LitSurface& surface, int row, int col) {
  const auto by_col = change(surface, row, col, 0, 1);
  const auto by_row = change(surface, row, col, 1, 0);
  if (!by_col || !by_row) return 0;
  const Vec3 to_projector = surface.projector_centre_mm - surface.position(row, col);
  const Vec3 area = by_row->position_mm.cross(by_col->position_mm);  // towards the camera
  const double facing_mm2 = area.dot(to_projector) / cv::norm(to_projector);
  return std::max(0.0, facing_mm2) * at(surface.gain, row, col) /
         at(surface.cos_projector, row, col);
}

}  // namespace

bool LitSurface::is_lit(int row, int col) const {
  return (validity.at(row, col) & kValidityErrors) == 0;
}

Vec3 LitSurface::position(int row, int col) const {
  return {at(position_mm[0], row, col), at(position_mm[1], row, col), at(position_mm[2], row, col)};
}

bool goes_on(const LitSurface& surface, int row, int col, int other_row, int other_col) {
  const Vec3 here = surface.position(row, col);
  const Vec3 change = surface.position(other_row, other_col) - here;
  const Vec3 sight = here / cv::norm(here);
  const double along = change.dot(sight);
  return std::abs(along) <= kMaxSlope * cv::norm(change - along * sight);
}

LocalPlane local_plane(const LitSurface& surface, int row, int col) {
  const auto by_col = change(surface, row, col, 0, 1);
  const auto by_row = change(surface, row, col, 1, 0);
  if (!by_col || !by_row) return {};
  const Vec3 normal(at(surface.normal[0], row, col), at(surface.normal[1], row, col),
                    at(surface.normal[2], row, col));
  LocalPlane plane;
  plane.by_col_mm = by_col->position_mm - by_col->position_mm.dot(normal) * normal;
  plane.by_row_mm = by_row->position_mm - by_row->position_mm.dot(normal) * normal;
  // The in-plane gradient that explains both steps, made as long as the pitch says.
  const Vec3 cross = plane.by_col_mm.cross(plane.by_row_mm);
  const double area2 = cross.dot(cross);
  if (!(area2 > 0)) return {};
  Vec3 gradient = (by_col->position_px * plane.by_row_mm.cross(cross) +
                   by_row->position_px * cross.cross(plane.by_col_mm)) /
                  area2;
  const double length = cv::norm(gradient);
  if (!(length > 0)) return {};
  gradient *= 1 / (length * at(surface.pitch_mm, row, col));
  plane.px_by_col = gradient.dot(plane.by_col_mm);
  plane.px_by_row = gradient.dot(plane.by_row_mm);
  const Vec3 here = surface.position(row, col);
  const Vec3 sight = here / cv::norm(here);
  plane.across_mm = cv::norm(by_col->position_mm - by_col->position_mm.dot(sight) * sight);
  plane.is_known =
      plane.across_mm > 0 && std::isfinite(plane.px_by_col) && std::isfinite(plane.px_by_row);
  return plane;
}

LitPatches::LitPatches(const LitSurface& surface, int side, int period_px)
    : side_px(side), rows(surface.height_px() / side), cols(surface.width_px() / side) {
  const auto count = static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols);
  for (auto* axis : {&x_mm, &y_mm, &z_mm}) axis->assign(count, kFarAway);
  for (auto* light : {&flux_mm2, &cos_phase, &sin_phase}) light->assign(count, 0.0F);
  const double rad_per_px = 2 * std::numbers::pi / period_px;
  tbb::parallel_for(0, rows, [&](int block_row) {
    for (int block_col = 0; block_col < cols; ++block_col) {
      double flux = 0;
      Vec3 centre(0, 0, 0);
      double re = 0, im = 0;
      for (int row = block_row * side; row < (block_row + 1) * side; ++row)
        for (int col = block_col * side; col < (block_col + 1) * side; ++col) {
          if (!surface.is_lit(row, col)) continue;
          const double part = piece_flux_mm2(surface, row, col);
          flux += part;
          centre += part * surface.position(row, col);
          const double phase = rad_per_px * at(surface.position_px, row, col);
          re += part * std::cos(phase);
          im += part * std::sin(phase);
        }
      if (!(flux > 0)) continue;
      const auto i = static_cast<std::size_t>(block_row) * static_cast<std::size_t>(cols) +
                     static_cast<std::size_t>(block_col);
      x_mm[i] = static_cast<float>(centre[0] / flux);
      y_mm[i] = static_cast<float>(centre[1] / flux);
      z_mm[i] = static_cast<float>(centre[2] / flux);
      flux_mm2[i] = static_cast<float>(flux);
      const double length = std::hypot(re, im);
      cos_phase[i] = static_cast<float>(re / length);
      sin_phase[i] = static_cast<float>(im / length);
    }
  });
}

}  // namespace estimation
