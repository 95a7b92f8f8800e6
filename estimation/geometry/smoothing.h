// Local quadric fits to inverse depth, which is exact for planes, without crossing depth jumps.
#pragma once

#include <functional>
#include <vector>

#include "estimation/base/image.h"

namespace estimation {

// All [height][width]; NaN in inverse_depth: no point there.
struct DepthMap {
  ImageView<const float> inverse_depth_per_mm;
  ImageView<const float> relative_sd;  // of one pixel's depth
};

struct FitOptions {
  // Of the window; its Gaussian weight's sigma is half of it. 0: no smoothing, slopes by
  // differences over five points.
  int radius_px = 4;
  double max_relative_step = 0.01;  // of depth from pixel to pixel beside noise; more is a jump
  int discontinuity_radius_px = 4;
};

// One row's fits, [col]; NaN where the pixel has no depth or too few neighbours on its own surface.
struct FitRow {
  std::vector<float> inverse_depth_per_mm;
  std::vector<float> by_col, by_row;  // its derivatives, 1/(mm px)
  std::vector<float> noise_gain;      // standard deviation after over before
  std::vector<float> slope_gain;      // that of a derivative over before, 1/px; mean of two axes
  std::vector<char> is_near_discontinuity;
};

// Gives each row to `take` once, in any order and from the threads of the caller's oneTBB arena;
// the row lives as long as the call. Same result for any number of threads.
void fit_locally(const DepthMap& depth, const FitOptions& options,
                 const std::function<void(int row, const FitRow&)>& take);

}  // namespace estimation
