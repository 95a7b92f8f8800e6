// `--indirect auto`: B = 0 must be earned (design/estimation.md, sections 3 and 4).
#pragma once

#include <cstddef>

#include "estimation/profile/likelihood_scene.h"
#include "estimation/session/manifest.h"

namespace estimation {

// What all samples of a pixel err by together (BandRadiometry::common_variance) looks like indirect
// light: adds it to the variance of B. To be called before the choice below, which then holds B to
// zero only as far as that error allows.
void add_common_noise(const StripeScene& scene, const BandRadiometry& radiometry, SiteFits& fits);

// Fixes B at zero for the sites whose neighbourhood has none: about 15 x 15 sites of like R_d tell
// the mean of B and its standard deviation, and |mean| + 2 sd must be below a third of the pixel's
// own sd of B, so that what bias is left is below a third of the standard deviation gained. The
// update of the others is the Gaussian's conditional in closed form; what the neighbourhood leaves
// open of B stays in the covariance. Sets kIndirectFixedAtZero.
//   fits     with B free; every site in the frame's order
//   returns  how many were fixed. Same bits for any number of threads.
std::size_t fix_indirect_where_earned(const CameraInfo& camera, SiteFits& fits);

}  // namespace estimation
