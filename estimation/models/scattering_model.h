// A material as the estimator sees it: how much of a sinusoidal irradiance comes back out of it.
#pragma once

#include <memory>
#include <span>
#include <string>

#include "estimation/session/error.h"

namespace estimation {

struct Coefficients {
  double sigma_a_per_mm = 0;        // absorption
  double sigma_s_prime_per_mm = 0;  // reduced scattering
};

// R~(k), the 2-D Fourier transform of the radial scattering profile R_d(r) of a half space. At
// given refractive index it depends on (R_d, k l_d) alone, R_d = R~(0) the total diffuse
// reflectance and l_d the diffuse mean free path, so one function serves every pitch. Immutable,
// thread-safe.
class ScatteringModel {
 public:
  virtual ~ScatteringModel() = default;

  // The name on the command line and in the maps' headers.
  virtual std::string name() const = 0;

  // out[i] = R~ at k = k_times_l_d[i] / l_d (rad), same length; diffuse_reflectance in 0..1.
  virtual void transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                         std::span<double> out) const = 0;

  // sigma_a and sigma_s' of the medium with this R_d in (0, 1) and l_d > 0.
  virtual Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const = 0;
};

// Models by name: "dipole". `eta` is the medium's refractive index relative to air, 1 to 2.
// Errors: kInvalid for an unknown name or an eta out of range, naming what is known.
Result<std::unique_ptr<ScatteringModel>> make_scattering_model(const std::string& name, double eta);

}  // namespace estimation
