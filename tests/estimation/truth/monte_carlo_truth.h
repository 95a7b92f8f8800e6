// Stripe signals from tabulated Monte Carlo reflectance over spatial frequency: truth that no model
// of the estimator was made from.
#pragma once

#include <complex>
#include <filesystem>
#include <string>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/session/error.h"
#include "tests/estimation/truth/stripe_response.h"

namespace estimation::truth {

// A medium under normal incidence, R(f) per flux transmitted into it.
struct MonteCarloMedium {
  std::string name;
  Coefficients medium;
  double photon_count = 0;
  std::vector<double> reflectance;  // [i] at f = i * freq_step_per_mm
  double freq_step_per_mm = 0;

  // By cubics through neighbouring points. Beyond the last frequency (1/mm) ln R continues along
  // its slope in ln f over the last fifth of the table: less than 2% of the stripes' contrast lies
  // there at a pitch of 0.3 mm.
  double at(double freq_per_mm) const;
};

// tests/data/mc_truth_rf.csv. Errors: kNotFound, kInvalid (line and expectation).
Result<std::vector<MonteCarloMedium>> read_monte_carlo_truth(const std::filesystem::path& file);

// T(theta_i) = 1 - F of unpolarised light entering a medium of index eta.
double fresnel_transmission(double eta, double cos_incidence);

// The reflectance factor over the position in the stripes: R(f) summed over all harmonics up to
// `greatest_freq_per_mm`, times `transmission`.
PeriodicCurve monte_carlo_curve(const MonteCarloMedium& medium, StripeShape shape, double pitch_mm,
                                double transmission, double greatest_freq_per_mm = 8);

// A medium lit and seen obliquely: complex R~(f), T(theta_i) and h(theta_o) included or not as the
// file says (tests/data/mc_tilted.csv).
struct TiltedMedium {
  std::string name;
  Coefficients medium;
  Directions directions;
  std::vector<double> freq_per_mm;  // rising, from 0
  std::vector<std::complex<double>> reflectance;
  std::vector<double> standard_error;

  std::complex<double> at(double freq_per_mm) const;  // as MonteCarloMedium::at, log |R| and phase
};

// Errors: kNotFound, kInvalid.
Result<std::vector<TiltedMedium>> read_tilted_truth(const std::filesystem::path& file);

// r(x) = w/P R~(0) + 2 sum w/P sinc(n w/P) Re[R~(f_n) exp(2 pi i n x/P)].
PeriodicCurve tilted_curve(const TiltedMedium& medium, StripeShape shape, double pitch_mm,
                           double greatest_freq_per_mm = 8);

}  // namespace estimation::truth
