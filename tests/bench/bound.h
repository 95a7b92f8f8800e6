// The Cramer-Rao bound from the spatial truth alone: no table, transform or derivative of the
// estimator takes part.
#pragma once

#include <memory>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "tests/estimation/truth/sensor.h"
#include "tests/estimation/truth/stripe_response.h"

namespace bench {

// Least standard deviations: root of the mean variance over the pixel's position in the stripes.
struct Bound {
  double log_reflectance = 0, log_translucency = 0;  // relative: of ln R_d, ln l_d
  double log_sigma_a = 0, log_sigma_s_prime = 0;
  double indirect = 0, phase_px = 0;
};

// Derivatives of the stripes' response by ln sigma_a and ln sigma_s', by central differences of
// curves that are good to 1e-12; kept for each medium and pitch asked for. Not thread-safe.
class BoundOfTruth {
 public:
  BoundOfTruth(double eta, estimation::StripeShape shape) : eta_(eta), shape_(shape) {}

  struct Case {
    estimation::Coefficients medium;
    double pitch_mm = 0.3;
    double indirect = 0;
    std::vector<int> shifts_px;
    estimation::truth::Sensor sensor;
    bool is_indirect_free = true;
  };
  Bound bound(const Case& wanted);

 private:
  struct Derivatives {
    estimation::Coefficients medium;
    double pitch_mm = 0;
    std::unique_ptr<estimation::truth::PeriodicCurve> value, by_log_a, by_log_s;
    // ln R_d and ln l_d by ln sigma_a and ln sigma_s'
    double reflectance_by_a = 0, reflectance_by_s = 0, translucency_by_a = 0, translucency_by_s = 0;
  };
  const Derivatives& derivatives(const estimation::Coefficients& medium, double pitch_mm);

  double eta_;
  estimation::StripeShape shape_;
  std::vector<Derivatives> known_;
};

}  // namespace bench
