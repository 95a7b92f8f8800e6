// The reconstructed surface as patches of light: where they lie, how much of the projector's light
// they catch, and at which phase of the stripes.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/base/linear.h"

namespace estimation {

// All [height][width] on the camera's grid.
struct LitSurface {
  std::array<ImageView<const float>, 3> position_mm;  // X, Y, Z
  std::array<ImageView<const float>, 3> normal;       // unit, towards the camera
  ImageView<const float> position_px;  // projector coordinate along the stripes' axis
  ImageView<const float> pitch_mm;     // mm on the surface per projector px, across the stripes
  ImageView<const float> gain;         // G of design/estimation.md, with the normal's cosine
  ImageView<const float> cos_projector;
  ImageView<const std::uint32_t> validity;  // of the surface: with an error bit there is no light
  Vec3 projector_centre_mm{0, 0, 0};

  int height_px() const { return validity.height_px; }
  int width_px() const { return validity.width_px; }
  bool is_lit(int row, int col) const;
  Vec3 position(int row, int col) const;
};

// Whether the surface goes on from a lit pixel to a lit neighbour, without a jump in depth.
bool goes_on(const LitSurface& surface, int row, int col, int other_row, int other_col);

// A pixel's own plane: one camera pixel to the right and one down move by `by_col` and `by_row`,
// both perpendicular to its normal, and the stripes' coordinate by the two numbers below.
struct LocalPlane {
  Vec3 by_col_mm{0, 0, 0}, by_row_mm{0, 0, 0};
  double px_by_col = 0, px_by_row = 0;
  double across_mm = 0;   // a camera pixel's side at that distance, across the line of sight
  bool is_known = false;  // false: no neighbours to tell it from
};

LocalPlane local_plane(const LitSurface& surface, int row, int col);

// Whole blocks of `side_px` x `side_px` camera pixels, row-major; structure of arrays. What is left
// at the picture's right and lower edge belongs to no patch.
struct LitPatches {
  int side_px = 1;
  int rows = 0, cols = 0;
  std::vector<float> x_mm, y_mm, z_mm;      // far away where there is no light
  std::vector<float> flux_mm2;              // irradiance (1: the standard's) times area
  std::vector<float> cos_phase, sin_phase;  // of 2 pi position / period

  // Runs in the caller's oneTBB arena; the same bits for any number of threads. A patch's flux is
  // what the projector sends into its solid angle, from the positions alone: an error of the
  // normal at one pixel moves light but makes none.
  LitPatches(const LitSurface& surface, int side_px, int period_px);

  // Patches of a quarter of l_d, at least a camera pixel.
  static int side_for(double translucency_mm, double pixel_mm) {
    return std::max(1, static_cast<int>(0.25 * translucency_mm / pixel_mm + 0.5));
  }
};

}  // namespace estimation
