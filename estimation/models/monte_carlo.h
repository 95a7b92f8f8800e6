// The model `monte_carlo`: R~(k) from a white Monte Carlo table (models/monte_carlo/), at normal
// incidence, all exit directions together, per flux transmitted into the medium.
//
// Everything is a function of s = 1/(l_d sigma_s') = sqrt(3 x (1 + x)), x = sigma_a/sigma_s'.
// Between the table's nodes ln[R~ (1 + slope q)], q = sqrt(s^2 + (k/sigma_s')^2), is a bicubic
// spline in asinh(s) and asinh(k): twice continuously differentiable, and with 1 - R~ = slope q
// exact at the origin. Any R_d from 0 to 1 is answered: below the table (R_d of about 1e-6 and
// less), and above k = 2.7e5 sigma_s', the logarithms go on as straight lines, as light that
// scattered once does.
#pragma once

#include <vector>

#include "estimation/models/monte_carlo/scattering_table.h"
#include "estimation/models/scattering_model.h"

namespace estimation {

class MonteCarlo : public ScatteringModel {
 public:
  explicit MonteCarlo(const ScatteringTable& table);

  std::string name() const override { return "monte_carlo"; }
  // NaN for an R_d outside of 0..1 or a negative frequency. Does not allocate.
  void transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                 std::span<double> out) const override;
  // (1 - F(theta_i)) h(theta_o), real, the same for all frequencies; 0 for light or sight from
  // below.
  void direction_factors(double diffuse_reflectance, std::span<const double> k_times_l_d,
                         const Directions& directions,
                         std::span<std::complex<double>> out) const override;
  Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const override;

  // R_d as a function of s >= 0; falls from 1 to 0. Its inverse, to 1e-14 of s; NaN outside of
  // 0..1.
  double reflectance_at(double s) const;
  double s_at(double diffuse_reflectance) const;

  // R~ at k/sigma_s', and its standard error over it (of the table's photons).
  double transform_at(double s, double k_tmfp) const;
  double relative_standard_error(double s, double k_tmfp) const;

  // The exit radiance towards cos_exit over that of a Lambertian surface of the same exitance.
  double exit_radiance(double s, double cos_exit) const;

 private:
  // -ln R_d.
  double attenuation(double s) const;
  // s to start from where -ln R_d is this.
  double first_guess(double attenuation) const;

  double eta_;
  TableGrid grid_;
  double slope_;
  std::size_t row_size_;                              // coefficients for one s
  std::vector<double> coefficients_;                  // of the bicubic spline, [s][k]
  std::vector<double> reflectance_;                   // the same spline at k = 0, [s]
  std::vector<double> attenuation_;                   // -ln R_d at the nodes, [s]
  std::vector<double> standard_error_;                // [s][k], nodes
  std::array<std::vector<double>, 4> exit_radiance_;  // spline coefficients of b_0 .. b_3, [s]
};

// The model of a shipped table. Errors: kInvalid for an eta and g that no table has, naming those
// there are.
Result<std::unique_ptr<ScatteringModel>> make_monte_carlo(const MediumOptions& medium);

}  // namespace estimation
