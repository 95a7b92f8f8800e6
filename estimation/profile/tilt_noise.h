// What noise of a surface's normals leaves open of a fit's values. A normal that leans by d towards
// the light brightens the surface by d tan(theta) and shortens the projector's pixels on it; a fit
// that is told so finds another medium, by known factors of d.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/coefficient_curve.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/noise.h"

namespace estimation {

// Relative standard deviations of a pixel's light by tilts along the stripes' axis, which move the
// pitch by as much in the opposite sense, and across it, which leave the pitch.
struct TiltNoise {
  double along = 0, across = 0;
};

// To be added to the fit's variances: relative ones, B's own.
struct TiltVariances {
  double diffuse_reflectance = 0, translucency = 0, sigma_a = 0, sigma_s_prime = 0, indirect = 0;
};

// What a fit found.
struct TiltedFit {
  double logit = 0;  // ln(R_d / (1 - R_d))
  bool is_indirect_free = true;
};

// A typical pixel, for the weights and the contrast that the fits of a band had.
struct TypicalSite {
  StripeShape shape;
  double full_per_us = 0;  // DN/us of a perfect reflector
  double translucency_px = 0, indirect = 0;
  std::span<const MergedNoise> noise;  // borrowed during construction
};

// Immutable, thread-safe.
class TiltEffect {
 public:
  // For logits in this range.
  TiltEffect(const ScatteringModel& model, const TypicalSite& site, double least_logit,
             double greatest_logit);

  TiltVariances at(const TiltedFit& fit, const CoefficientCurve::At& curves, TiltNoise tilt) const;

 private:
  // Derivatives by the relative error of the light that the fit is told.
  struct Response {
    double logit = 0, log_translucency = 0, indirect = 0;
  };
  Response response_at(const TiltedFit& fit) const;

  double least_;
  std::array<std::vector<Response>, 2> responses_;  // [is B free][i] at least_ + i step
};

}  // namespace estimation
