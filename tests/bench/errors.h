// What a set of estimates was worth: errors against the truth, and whether stated uncertainties
// hold.
#pragma once

#include <vector>

#include "estimation/models/scattering_model.h"
#include "tests/bench/pixels.h"

namespace bench {

// Relative errors (estimate / truth - 1) over the valid pixels.
struct Errors {
  struct Quantity {
    double rms = 0, bias = 0, sd = 0;
  };
  Quantity translucency, reflectance, sigma_a, sigma_s_prime;
  double indirect_bias = 0, u_bias_px = 0;
  double valid_frac = 0;
  // Of ln l_d: the share of valid pixels within one and two stated standard deviations, and the
  // mean square of error over standard deviation; zero from estimators that state none.
  double within_1_sd = 0, within_2_sd = 0, pull_variance = 0;
  double median_chi_square = 0;
};

// `model` turns the estimates' R_d and l_d into sigma_a and sigma_s'; null: those stay zero.
// Summed in order: the same bits for any number of threads.
Errors errors_of(const PixelSet& pixels, const std::vector<Estimate>& estimates,
                 const estimation::ScatteringModel* model);

}  // namespace bench
