// How much light a surface point gets, relative to the reflectance standard: the paper's section 6
// (cosine) and 7 (normalisation), with the projector's vignetting and the fall-off with distance.
#pragma once

#include <optional>

#include "estimation/base/image.h"

namespace estimation {

struct Illumination {
  ImageView<const float> vignetting;  // [projector height][width], 1 at the centre; or empty
  std::optional<double> reference_distance_mm;  // absent: no fall-off

  // G = vignetting(column, row) * cos_projector * (reference / distance)^2. The vignetting is
  // interpolated and continued by its border; a pixel without a projector row takes the middle one.
  double at(double column_px, double row_px, double cos_projector, double distance_mm) const;
};

}  // namespace estimation
