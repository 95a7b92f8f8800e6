// Normalized diffusion of Christensen and Burley, "Approximate Reflectance Profiles for Efficient
// Subsurface Scattering" (2015), with the diffuse mean free path as its parameter:
//   R(r) = A (exp(-r/d) + exp(-r/(3d))) / (8 pi d r),  d = l_d / s,  s = 3.5 + 100 (A - 0.33)^4
// whose transform is A/4 [ 1/sqrt(1 + (k d)^2) + 1/sqrt(1/9 + (k d)^2) ]; A = R_d.
#pragma once

#include "estimation/models/dipole.h"

namespace estimation {

// s of the formula above: l_d over the profile's own length d.
double burley_scale(double diffuse_reflectance);

// Coefficients: the profile names none. They are those of the dipole with the same R_d and l_d
// (eqs. 5 and 6 of the paper), which is how renderers' tables pair albedo and dmfp with published
// coefficients (RenderMan's PxrSurface; design/facts.md, section 5.2).
class Burley : public ScatteringModel {
 public:
  explicit Burley(double eta) : dipole_(eta) {}

  std::string name() const override { return "burley"; }
  void transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                 std::span<double> out) const override;
  Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const override {
    return dipole_.coefficients(diffuse_reflectance, translucency_mm);
  }

 private:
  Dipole dipole_;
};

}  // namespace estimation
