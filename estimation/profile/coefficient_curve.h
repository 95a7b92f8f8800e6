// sigma_a and sigma_s' of a model as smooth curves over R_d: both fall as 1 / l_d at given R_d, so
// one curve each serves every pixel, with the derivative that carries the uncertainty over.
#pragma once

#include <optional>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/models/scattering_model.h"

namespace estimation {

// Immutable, thread-safe.
class CoefficientCurve {
 public:
  // For t = ln(R_d / (1 - R_d)) in this range.
  CoefficientCurve(const ScatteringModel& model, double least_logit, double greatest_logit);

  // ln(sigma l_d) and its derivative by t.
  struct Value {
    double log_product = 0, slope = 0;
  };
  struct At {
    Value sigma_a, sigma_s_prime;
  };
  At at(double logit) const;

  // As the model's, for R_d in (0, 1).
  Coefficients coefficients(double diffuse_reflectance, double translucency_mm) const;

 private:
  double least_, step_;
  std::vector<double> log_a_, log_s_;  // at least_ + (i - 1) step_
};

// Over what a map of R_d holds; nullopt where that is nothing.
std::optional<CoefficientCurve> curve_over(const ScatteringModel& model,
                                           const Image<float>& diffuse_reflectance);

}  // namespace estimation
