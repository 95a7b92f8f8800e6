// One pixel's response to stripe patterns in closed form (design/estimation.md, section 1), summed
// directly: no table, no interpolation.
#pragma once

#include <cmath>
#include <numbers>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "estimation/models/dipole.h"
#include "estimation/profile/stripe_set.h"

namespace estimation::testing {

struct Skin {
  const char* name;
  Coefficients medium;
};
// The paper's Table 2.
inline constexpr Skin kCheekRed{"cheek red", {0.0525, 1.2814}};
inline constexpr Skin kCheekGreen{"cheek green", {0.1653, 1.5000}};
inline constexpr Skin kLipsBlue{"lips blue", {0.2835, 0.7982}};
inline constexpr Skin kStubbleBlue{"stubble blue", {0.6707, 0.6648}};

inline StripeSet stripe_set(int period_px, int width_px, std::vector<int> shifts_px) {
  StripeSet set{.axis = Axis::kColumn,
                .shape = {.period_px = period_px, .width_px = width_px},
                .shifts_px = std::move(shifts_px)};
  for (std::size_t i = 0; i < set.shifts_px.size(); ++i) set.sources.push_back({i});
  return set;
}

inline StripeSet paper_stripes() {
  std::vector<int> shifts(40);
  std::iota(shifts.begin(), shifts.end(), 0);
  return stripe_set(40, 8, shifts);
}

// r(s) at projector position u_px; m_n = exp(-(n/blur_harmonic)^2), 0 means perfect optics.
inline std::vector<double> reflectance_factors(const StripeSet& stripes, const Coefficients& medium,
                                               double eta, double pitch_mm, double u_px,
                                               double indirect, double blur_harmonic = 0,
                                               int term_count = 3000) {
  const double period = stripes.shape.period_px, duty = stripes.shape.width_px / period;
  const double reflectance = dipole_reflectance(medium, eta);
  const double l_d_px = diffuse_mean_free_path_mm(medium) / pitch_mm;
  std::vector<double> k(static_cast<std::size_t>(term_count)),
      transform(static_cast<std::size_t>(term_count));
  for (int n = 0; n < term_count; ++n)
    k[static_cast<std::size_t>(n)] = 2 * std::numbers::pi * n / period * l_d_px;
  Dipole(eta).transform(reflectance, k, transform);
  std::vector<double> amplitude(k.size(), 0);
  for (int n = 1; n < term_count; ++n) {
    const double x = std::numbers::pi * n * duty;
    const double m = blur_harmonic > 0 ? std::exp(-std::pow(n / blur_harmonic, 2)) : 1;
    amplitude[static_cast<std::size_t>(n)] =
        2 * duty * std::sin(x) / x * m * transform[static_cast<std::size_t>(n)];
  }
  std::vector<double> r;
  for (const int shift : stripes.shifts_px) {
    const double angle =
        2 * std::numbers::pi * (u_px - shift - 0.5 * (stripes.shape.width_px - 1)) / period;
    double sum = duty * (transform[0] + indirect);
    double previous = 1, cosine = std::cos(angle);  // of (n - 1) and n times the angle
    const double twice = 2 * cosine;
    for (std::size_t n = 1; n < amplitude.size(); ++n) {
      sum += amplitude[n] * cosine;
      previous = std::exchange(cosine, twice * cosine - previous);
    }
    r.push_back(sum);
  }
  return r;
}

}  // namespace estimation::testing
