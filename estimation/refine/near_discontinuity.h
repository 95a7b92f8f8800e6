// Pixels whose profile is not that of a flat, even, endless material: the surface, its light or
// its material breaks off within reach of the light that spreads below it.
#pragma once

#include "estimation/base/image.h"
#include "estimation/refine/spread_field.h"

namespace estimation {

struct DiscontinuityOptions {
  // In l_d of the material. Beside the end of the light the ordinary fit errs in sigma_a by 50% at
  // 0.8 l_d, 20% at 2, 4% at 2.9 and 1% at 4 (refine_test.cpp, cheek red, B free).
  double reach = 3;
  // A hole narrower than this many l_d lets no light escape: a lost pixel, not a border.
  double least_hole = 0.5;
  // Of R_d, and of l_d, from one side of a pixel to the other, half an l_d wide means 1 l_d apart:
  // a step, if it also exceeds four of its own standard deviations.
  double least_reflectance_step_frac = 0.1;
  double least_translucency_step_frac = 0.2;
};

// [height][width], 1 within `reach` l_d of a border: of the lit surface (the background, a shadow,
// a jump in depth), or of the material. 0 elsewhere and where nothing is lit.
//   surface   only positions and validity are looked at
//   material  the band with the widest l_d
Image<unsigned char> near_discontinuity(const LitSurface& surface, const BandMaterial& material,
                                        const DiscontinuityOptions& options = {});

}  // namespace estimation
