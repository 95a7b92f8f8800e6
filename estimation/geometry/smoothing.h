// Local quadric fits to inverse depth, which is exact for planes, without crossing depth jumps.
#pragma once

#include "estimation/base/image.h"

namespace estimation {

// All [height][width]; NaN in inverse_depth: no point there.
struct DepthMap {
  ImageView<const float> inverse_depth_per_mm;
  ImageView<const float> relative_sd;  // of one pixel's depth
};

struct FitOptions {
  int radius_px = 4;                // of the window; its Gaussian weight's sigma is half of it
  double max_relative_step = 0.01;  // of depth from pixel to pixel beside noise; more is a jump
  int discontinuity_radius_px = 4;
};

// NaN where the pixel has no depth or too few neighbours on its own surface.
struct LocalFit {
  Image<float> inverse_depth_per_mm;
  Image<float> by_col, by_row;  // its derivatives, 1/(mm px)
  Image<float> noise_gain;      // standard deviation after over before
  Image<float> slope_gain;      // that of a derivative over before, 1/px; mean of the two axes
  Image<unsigned char> is_near_discontinuity;
};

// Same result for any number of threads. Thread-safe.
LocalFit fit_locally(const DepthMap& depth, const FitOptions& options);

}  // namespace estimation
