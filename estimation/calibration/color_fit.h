// The matrix from camera rgb to display rgb, for renderings.
#pragma once

#include <span>
#include <vector>

#include "estimation/base/linear.h"
#include "estimation/session/error.h"

namespace estimation {

// A chart's patch: what the camera has of it as reflectance factors (signal over that of the
// reflectance standard, so a grey has three equal numbers), and what a display should show, linear.
struct ColorPatch {
  Vec3 camera, display;
};

struct ColorFit {
  Mat3 matrix = Mat3::eye();
  Mat3 sd = Mat3::zeros();  // of each element
  double residual_rms = 0;  // of display rgb
  double residual_max = 0;
};

// Least squares under the constraint that greys stay grey (rows sum to 1). Needs four patches of
// different colours. Errors: kInsufficient.
Result<ColorFit> fit_color_matrix(std::span<const ColorPatch> patches);

// From the projector's single colours on the reflectance standard: `camera_by_primary` has the
// camera's rgb under the red, green and blue pattern as columns (any common scale). The display's
// primaries are taken to be the projector's; their sum is white. Errors: kInsufficient where the
// camera cannot tell them apart.
Result<Mat3> color_matrix_from_primaries(const Mat3& camera_by_primary);

}  // namespace estimation
