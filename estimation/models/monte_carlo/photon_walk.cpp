#include "estimation/models/monte_carlo/photon_walk.h"

#include <algorithm>

#include "estimation/base/check.h"

namespace estimation {

Reflection inner_reflection(double eta, double cos_inside) {
  if (eta == 1) return {0, cos_inside};
  const double sin2_outside = eta * eta * (1 - cos_inside * cos_inside);
  if (sin2_outside >= 1) return {1, 0};
  const double cos_outside = std::sqrt(1 - sin2_outside);
  const double s = (eta * cos_inside - cos_outside) / (eta * cos_inside + cos_outside);
  const double p = (eta * cos_outside - cos_inside) / (eta * cos_outside + cos_inside);
  return {0.5 * (s * s + p * p), cos_outside};
}

Direction3 refracted_into(double eta, double cos_incidence, double azimuth_rad) {
  const double sin_inside = std::sqrt(std::max(0.0, 1 - cos_incidence * cos_incidence)) / eta;
  return {sin_inside * std::cos(azimuth_rad), sin_inside * std::sin(azimuth_rad),
          std::sqrt(1 - sin_inside * sin_inside)};
}

double transmitted_frac(double eta, double cos_incidence) {
  if (!(cos_incidence > 0)) return 0;
  // Reflection is the same from both sides of the boundary.
  const double sin2_inside = (1 - cos_incidence * cos_incidence) / (eta * eta);
  return 1 - inner_reflection(eta, std::sqrt(1 - sin2_inside)).reflected_frac;
}

PhotonWalk::PhotonWalk(const WalkMedium& medium, const WalkLimits& limits)
    : medium_(medium),
      limits_(limits),
      mean_free_path_tmfp_(1 - medium.anisotropy),
      one_minus_g2_(1 - medium.anisotropy * medium.anisotropy),
      one_plus_g2_(1 + medium.anisotropy * medium.anisotropy),
      half_over_g_(medium.anisotropy == 0 ? 0 : 0.5 / medium.anisotropy) {
  check(medium.eta >= 1 && std::abs(medium.anisotropy) < 1 && medium.thickness_tmfp > 0,
        "a medium at least as dense as air, with |g| < 1 and some thickness");
}

}  // namespace estimation
