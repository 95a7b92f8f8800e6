// Fits that look determined by chance, where the data do not determine their kind.
#pragma once

#include <cstddef>

#include "estimation/profile/likelihood_scene.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Where l_d is large against the period, chi-square hardly rises towards larger ones. Noise that
// makes a pixel's estimate small makes its own standard deviation small as well, so that of a
// material that no pixel can tell, a fifth seems to be told: too small by many stated standard
// deviations (period 7 px, l_d 7 px: a fifth of the truth, at 2 to 8). No pixel can see that, its
// neighbours can: where less than two thirds of about 15 x 15 sites are identifiable, those are
// refused that know ln l_d no better than to 0.1. Sets kNotIdentifiable.
//   fits     with B free or zero, before anything is chosen by neighbourhoods
//   returns  how many were refused
std::size_t refuse_chance_fits(const CameraInfo& camera, SiteFits& fits);

}  // namespace estimation
