// The radial scattering profile R_d(r) of a model in space: the inverse Hankel transform of its
// R~(k).
#pragma once

#include <cstddef>
#include <vector>

#include "estimation/models/scattering_model.h"

namespace estimation {

// Tabulated over logit R_d and r / l_d, blurred by a Gaussian of kBlur l_d: a sum over patches of a
// quarter of l_d then stands for the integral (aliases below 1% of R~ at 25 / l_d), and models
// whose profile has a pole at r = 0 have a value there. Immutable, thread-safe.
class RadialProfile {
 public:
  static constexpr double kBlur = 0.12;  // standard deviation along an axis, in l_d
  static constexpr double kRadius =
      5;  // in l_d; beyond lies 0.9% of an R_d of 0.01, below 0.2% of 0.3 and more
  static constexpr std::size_t kStepsPerUnit = 100;
  static constexpr std::size_t kSteps = static_cast<std::size_t>(kRadius) * kStepsPerUnit;

  // For R_d between the two, both in (0, 1).
  RadialProfile(const ScatteringModel& model, double least_reflectance,
                double greatest_reflectance);

  // l_d^2 R_d(r) at r = i / kStepsPerUnit l_d, i = 0..kSteps, and a last value for reading
  // between; R_d beyond the ends takes the end's shape and keeps its own total.
  void line(double diffuse_reflectance, std::vector<float>& out) const;

 private:
  double least_logit_ = 0;
  std::size_t row_count_ = 0;
  std::vector<float> rows_;  // [logit][kSteps + 2], divided by R_d
};

}  // namespace estimation
