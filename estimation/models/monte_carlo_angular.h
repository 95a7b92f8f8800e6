// The model `monte_carlo_angular`: R~ of monte_carlo, and for every direction of light and of sight
// what it is multiplied with, complex, for oblique light comes out shifted sideways
// (design/estimation.md, section 1, "Oblique light").
//
// The factor is T(theta_i) T(theta_o) G(i, o; s, k) / R~(s, k): both Fresnel transmissions, and a
// Hermitian function of the two directions (models/monte_carlo_angular/direction_pairs.h), smooth
// in the refracted directions, whose coefficients are cubic splines in asinh of s and of
// k/sigma_s'. Beyond the table (sigma_a above 4.8 sigma_s', k above 13 sigma_s') the factor stays
// what it is at its end.
#pragma once

#include <vector>

#include "estimation/models/monte_carlo.h"
#include "estimation/models/monte_carlo_angular/angular_table.h"

namespace estimation {

class MonteCarloAngular : public MonteCarlo {
 public:
  // Both of the same medium.
  MonteCarloAngular(const ScatteringTable& hemispherical, const AngularTable& angular);

  std::string name() const override { return "monte_carlo_angular"; }
  // 0 for light or sight from below; NaN for an R_d outside of 0..1. Does not allocate.
  void direction_factors(double diffuse_reflectance, std::span<const double> k_times_l_d,
                         const Directions& directions,
                         std::span<std::complex<double>> out) const override;

  // The standard error of a factor's real or imaginary part (of the table's photons).
  double factor_standard_error(double s, double k_tmfp, const Directions& directions) const;

 private:
  double eta_;
  std::vector<float> coefficients_;    // of the bicubic splines, [pair][s][k]
  std::vector<float> standard_error_;  // of one coefficient, [s][k], nodes
};

// The model of a shipped table. Errors: kInvalid for an eta and g that no table has, naming those
// there are.
Result<std::unique_ptr<ScatteringModel>> make_monte_carlo_angular(const MediumOptions& medium);

}  // namespace estimation
