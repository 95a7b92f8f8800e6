// A sum of six Gaussians, the form in which renderers blur skin (d'Eon and Luebke, GPU Gems 3,
// chapter 14, 2007; six as theirs for skin):
//   R(r) = R_d sum_i w_i / (2 pi v_i) exp(-r^2 / (2 v_i)),  R~(k) = R_d sum_i w_i exp(-v_i k^2 / 2)
// The w_i, and the v_i in units of (l_d / s)^2, are the same for every material: a least-squares
// fit to normalized diffusion (estimation/models/burley.h, s from there), whose shape is one for
// all. The fit minimises the relative error of R~ at k l_d / s = 0 and 200 values evenly spaced in
// the logarithm from 0.01 to 20, under sum w_i = 1, over weights, first variance and their common
// ratio. It leaves 0.7% rms, at most 2.5%. Gaussians end abruptly: beyond k l_d / s = 60 nothing is
// left.
#pragma once

#include <array>

#include "estimation/models/dipole.h"

namespace estimation {

struct Gaussian {
  double variance;  // along one axis, in (l_d / s)^2
  double weight;    // of all, 1
};
const std::array<Gaussian, 6>& profile_gaussians();

// Coefficients as those of Burley: the dipole's with the same R_d and l_d.
class Gaussians : public ScatteringModel {
 public:
  explicit Gaussians(double eta) : dipole_(eta) {}

  std::string name() const override { return "gaussians"; }
  void transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                 std::span<double> out) const override;
  Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const override {
    return dipole_.coefficients(diffuse_reflectance, translucency_mm);
  }

 private:
  Dipole dipole_;
};

}  // namespace estimation
