// A material as the estimator sees it: how much of a sinusoidal irradiance comes back out of it.
#pragma once

#include <complex>
#include <memory>
#include <span>
#include <string>

#include "estimation/session/error.h"

namespace estimation {

struct Coefficients {
  double sigma_a_per_mm = 0;        // absorption
  double sigma_s_prime_per_mm = 0;  // reduced scattering
};

// How light meets and leaves a surface point. Angles to the normal, outside of the medium; azimuths
// in the tangent plane, from the direction in which the stripes' projector coordinate grows
// fastest.
struct Directions {
  double cos_incidence = 1;
  double cos_exit = 1;
  double incidence_azimuth_rad = 0;  // of the direction towards the projector
  double exit_azimuth_rad = 0;       // of the direction towards the camera
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

  // out[i] = what to multiply transform() with for light from and to these directions: the
  // surface's transmission T, the exit radiance h over its mean, and the sideways shift of oblique
  // light, whose phase is positive where the pattern appears moved towards smaller projector
  // coordinates (design/estimation.md, section 1; r(s) holds Re[out * exp(i k (x - x_s))]). 1 for
  // models without directions, such as the paper's.
  virtual void direction_factors(double diffuse_reflectance, std::span<const double> k_times_l_d,
                                 const Directions& directions,
                                 std::span<std::complex<double>> out) const;

  // sigma_a and sigma_s' of the medium with this R_d in (0, 1) and l_d > 0.
  virtual Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const = 0;
};

struct MediumOptions {
  double eta = 1.4;         // refractive index relative to air, 1 to 2
  double anisotropy = 0.8;  // g, the mean cosine of scattering; models without one ignore it
  bool operator==(const MediumOptions&) const = default;
};

// Models by name: "dipole", "burley", "gaussians", "monte_carlo", "monte_carlo_angular". Errors:
// kInvalid for an unknown name or options that the model does not have, naming what is known.
Result<std::unique_ptr<ScatteringModel>> make_scattering_model(const std::string& name,
                                                               const MediumOptions& medium);

}  // namespace estimation
