// Fits that look determined by chance, where the data do not determine their kind.
#pragma once

#include <cstddef>
#include <optional>

#include "estimation/profile/likelihood_scene.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Fits that know ln l_d worse than this are judged by their neighbourhood.
inline constexpr double kVagueLogSd = 0.1;

// What the variances of vague fits are to be multiplied with where this share of a neighbourhood is
// identifiable; nullopt: they are to be refused.
std::optional<double> vague_variance_gain(double identifiable_frac);

// Where l_d is large against the period, chi-square hardly rises towards larger ones. Noise that
// makes a pixel's estimate small makes its own standard deviation small as well, so that of a
// material that no pixel can tell, a fifth seems to be told: too small by many stated standard
// deviations (period 7 px, l_d 7 px: a fifth of the truth, at 2 to 8). No pixel can see that, its
// neighbours can: by the share of about 15 x 15 sites that are identifiable, vague fits are refused
// (kNotIdentifiable), or state accordingly larger variances.
//   fits     with B free or zero, before anything is chosen by neighbourhoods
//   returns  how many were refused
std::size_t judge_vague_fits(const CameraInfo& camera, SiteFits& fits);

}  // namespace estimation
