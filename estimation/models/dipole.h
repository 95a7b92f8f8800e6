// The dipole of Jensen et al. (2001), as used by Tariq et al. (2006), eqs. 3, 5 and 6, in closed
// form (design/estimation.md, section 1).
//
// Everything is written in s = sqrt(3 (1 - alpha')), 0 (no absorption) to sqrt(3) (no scattering):
//   R~(k) = alpha'/2 (1 + exp(-4/3 A Q)) exp(-Q),  Q = s sqrt(1 + (k l_d)^2),  alpha' = 1 - s^2/3
// which is eq. 5 at k = 0. Near R_d = 1 the textbook's 1 - alpha' loses all its digits; s does not.
#pragma once

#include "estimation/models/scattering_model.h"

namespace estimation {

// A = (1 + F_dr) / (1 - F_dr), F_dr = -1.440/eta^2 + 0.710/eta + 0.668 + 0.0636 eta: what internal
// reflection at the boundary does to the position of the virtual source.
double boundary_factor(double eta);

class Dipole : public ScatteringModel {
 public:
  explicit Dipole(double eta) : boundary_(boundary_factor(eta)) {}

  std::string name() const override { return "dipole"; }
  void transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                 std::span<double> out) const override;
  Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const override;

  // Eq. 5 as a function of s in 0..sqrt(3); falls from 1 to 0.
  double reflectance_at(double s) const;

  // The inverse of reflectance_at, exact at both ends; NaN outside 0..1.
  double s_at(double diffuse_reflectance) const;

 private:
  double boundary_;  // A
};

// Eqs. 5 and 6 forward, for the truth of tests and for tables of published coefficients.
double dipole_reflectance(const Coefficients& medium, double eta);
double diffuse_mean_free_path_mm(const Coefficients& medium);

}  // namespace estimation
