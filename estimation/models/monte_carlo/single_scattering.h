// The light that leaves a half space after exactly one scattering, in closed form up to one
// integral. It rules R~ at high absorption and at high frequency, where a walk has its largest
// relative noise.
//
//   R1(k, x) = 2 pi sigma_s / eta^2 Int_0^1 dc  c p(-m) (1 - F(c)) / sqrt(sigma_t^2 (1 + m)^2 + k^2
//   (1 - m^2))
//
// c the cosine outside, m = sqrt(1 - (1 - c^2) / eta^2) inside, p Henyey-Greenstein's phase
// function, sigma_s = 1/(1 - g), sigma_t = sigma_s + x; lengths in 1/sigma_s', normal incidence,
// per transmitted flux. (Int_0^inf exp(-a z) J_0(b z) dz = 1/sqrt(a^2 + b^2) over the depth.)
#pragma once

#include <vector>

#include "estimation/models/monte_carlo/photon_walk.h"

namespace estimation {

class SingleScattering {
 public:
  explicit SingleScattering(const WalkMedium& medium);

  // R1 at absorption x = sigma_a/sigma_s' and k_tmfp = k/sigma_s'.
  double transform(double absorption, double k_tmfp) const { return sum(absorption, k_tmfp, 0, 1); }

  // The part of R1(0, x) that leaves with a cosine between these.
  double flux_between(double absorption, double cos_from, double cos_to) const {
    return sum(absorption, 0, cos_from, cos_to);
  }

 private:
  double sum(double absorption, double k_tmfp, double cos_from, double cos_to) const;

  WalkMedium medium_;
  double sigma_s_;
};

// Nodes and weights of Gauss-Legendre quadrature over 0..1.
struct Quadrature {
  std::vector<double> node, weight;
};
Quadrature gauss_legendre(int count);

}  // namespace estimation
