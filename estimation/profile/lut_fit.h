// The paper's estimate of one pixel in one band: R_d from the fully lit image, l_d from the table,
// indirect light from the minimum's excess, and the second match (sections 5.1 and 5.2).
//
// Where we read the paper freely: R_d is recomputed after the indirect light is subtracted; the
// minimum of a curve is the mean of its darkest eighth, because the least of 40 noisy samples lies
// too low (l_d of cheek red is then +0.7% off on the rig of design/estimation.md, else +0.1%).
#pragma once

#include <cstdint>
#include <span>

#include "estimation/profile/profile_match.h"
#include "estimation/profile/profile_table.h"
#include "estimation/session/maps.h"

namespace estimation {

struct LutFit {
  double diffuse_reflectance = 0;  // R_d, without indirect light
  double translucency_px = 0;      // l_d in projector pixels
  double indirect = 0;             // B on the scale of R_d
  double rms_residual = 0;         // of the area-normalised profile (mean 1) after the second match
  double log_translucency_sd = 0;  // of ln l_d, from the residual and the cost's curvature
  std::uint32_t validity = 0;      // kOutsideModel or kNotIdentifiable: the numbers mean nothing
};

// For the pixel loaded into `matcher`, whose samples are reflectance factors (r of
// design/estimation.md, section 1).
//   projector_black_frac  what the projector adds under a black pixel relative to white: light that
//                         fills the gaps of the stripes and is taken off before matching
LutFit fit_with_table(ProfileMatcher& matcher, const ProfileTable& table,
                      double projector_black_frac);

}  // namespace estimation
