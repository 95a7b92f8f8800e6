// A board's corner in a picture to a hundredth of a pixel: two straight blurred edges that cross,
// fitted to the pixels around. Private to this folder.
#pragma once

#include <opencv2/core.hpp>
#include <optional>

#include "estimation/base/image.h"
#include "estimation/geometry/lens.h"

namespace estimation {

// Where a corner is about, and how the board lies around it.
struct CornerStart {
  Vec2 px;                  // (col, row)
  Mat2 px_from_squares;     // board to picture, near the corner; unit: a square's edge
  double reach_frac = 0.4;  // pixels so many squares away along either axis are used ...
  double strip_frac = 0.5;  // ... and so near to either edge
};

struct FittedCorner {
  Vec2 px;
  double sd_px = 0;  // of each coordinate (rms of both), from what the fit leaves of the pixels
};

// Least squares over place, directions of both edges, their common blur, white, black and the
// light's slope. Pixels that are NaN are left out. Nullopt where the pixels do not show such a
// corner: too few, no contrast, or no solution near the start.
//   Why not cv::cornerSubPix: it takes gradients for edges, whose sampling and noise leave 0.03 to
//   0.07 px on the same pictures.
std::optional<FittedCorner> fit_corner(ImageView<const float> grey, const CornerStart& start);

}  // namespace estimation
