// A camera that looks at a stripe sweep: photons, read noise, whole numbers, two exposures, and
// what a real rig does wrong. The numbers of design/estimation.md's first paragraph.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "estimation/radiometry/noise.h"
#include "tests/estimation/truth/stripe_response.h"

namespace estimation::truth {

// Small, fast, one a pixel: the same numbers in any order of pixels (Steele et al., OOPSLA 2014).
class PixelRandom {
 public:
  using result_type = std::uint64_t;
  explicit PixelRandom(std::uint64_t seed) : state_(seed) {}
  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return ~result_type{0}; }
  result_type operator()();
  double uniform() { return static_cast<double>((*this)() >> 11) * 0x1p-53; }  // [0, 1)
  double normal();
  double poisson(double mean);

 private:
  std::uint64_t state_;
};

struct Sensor {
  double full_well_e = 20000;
  double read_noise_e = 10;
  double black_dn = 64;
  double saturation_dn = 4095;
  double short_us = 1000;
  double long_us = 4000;
  double white_frac = 0.85;      // of full well: a perfect reflector in the short exposure
  double light_frac = 1;         // of that light
  double nonlinearity_frac = 0;  // signal loses this share of itself at full well
  bool is_quantised = true;      // to whole DN
  bool is_noisy = true;          // else every sample is what it is expected to be

  double gain_e_per_dn() const { return full_well_e / (saturation_dn - black_dn); }
  double full_signal_dn_per_us() const {
    return light_frac * white_frac * (saturation_dn - black_dn) / short_us;
  }
  std::vector<MergedNoise> noise() const;  // what the estimator is told

  // DN/us of one sample, merged over both exposures by the product's rule: sum of DN over sum of
  // exposures of those below saturation. NaN if both are saturated.
  double read(double reflectance_factor, PixelRandom& random) const;
};

// How a pixel is seen, and what is wrong with it that the estimator is not told.
struct View {
  double u_px = 0;      // projector coordinate
  double indirect = 0;  // B
  double projector_black_frac = 0;
  double ambient = 0;   // reflectance factor left in under every phase
  double drift_px = 0;  // of u from the sweep's first to its last frame, linear in time
  double gain = 1;      // of the light, unknown to the estimator
};

// The reflectance factor of each shift without noise. `order` says at which place in time a shift
// was taken; empty: in order.
std::vector<double> sweep(const PeriodicCurve& curve, StripeShape shape,
                          std::span<const int> shifts_px, const View& view,
                          std::span<const int> order = {});

}  // namespace estimation::truth
