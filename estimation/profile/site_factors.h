// f_n of the likelihood (likelihood.h) at a site: what optics, the directions of light and a
// residual blur of the sweep leave of each harmonic.
#pragma once

#include <complex>
#include <cstddef>
#include <span>
#include <vector>

#include "estimation/profile/band_sites.h"
#include "estimation/profile/harmonic_table.h"
#include "estimation/profile/stripe_scene.h"

namespace estimation {

// Whether light's directions change anything in a model, and whether they move the profile.
struct Directionality {
  bool has_factors = false, has_shift = false;
  bool is_flat = true;  // the same factor for all frequencies
};
Directionality directionality_of(const ScatteringModel& model);

// One per task. The scene must outlive it.
class SiteFactors {
 public:
  //   blur_px2  variance of what the optics blur beyond their calibration; may be negative
  SiteFactors(const StripeScene& scene, int band, int harmonic_count, double blur_px2);

  // All f_n are 1: nothing to hand on.
  bool is_unity() const { return is_uniform_ && !direction_.has_factors && is_perfect_; }
  // The same at every site.
  bool is_uniform() const { return is_uniform_ && !direction_.has_factors; }
  bool needs_material() const { return direction_.has_factors; }

  // f_0 .. f_K at a site with this material; valid until the next call.
  std::span<const std::complex<double>> at(Site site, ShapePoint material);

 private:
  const StripeScene& scene_;
  int band_;
  Directionality direction_;
  bool is_uniform_ = true, is_perfect_ = true;
  std::vector<double> blur_;                 // [n]
  std::vector<float> contrast_;              // [n - 1] at the last site, or everywhere
  std::vector<double> k_times_l_d_;          // [n]
  std::vector<std::complex<double>> light_;  // [n]
  std::vector<std::complex<double>> factors_;
};

}  // namespace estimation
