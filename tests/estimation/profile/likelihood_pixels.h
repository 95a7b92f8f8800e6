// Noisy pixels of known material for the tests of the likelihood fit. Signals come from the
// reference model, noise as of design/estimation.md: 20 ke- full well, 10 e- read noise, exposures
// 1:4, a white reflector at 0.85 of full well in the short one.
#pragma once

#include <cmath>
#include <cstddef>
#include <numbers>
#include <random>
#include <vector>

#include "estimation/models/dipole.h"
#include "estimation/profile/fisher.h"
#include "estimation/profile/likelihood.h"
#include "likelihood_reference.h"

namespace estimation::testing {

inline constexpr double kWhiteDnPerUs = 0.85 * 4095 / 1000;  // of a 12-bit camera at 1000 us

inline std::vector<MergedNoise> paper_noise() {
  return merged_noise({1000, 4000}, {.gain_e_per_dn = 20000.0 / 4095, .read_noise_e = 10}, 4095);
}

struct Material {
  double sigma_a_per_mm, sigma_s_prime_per_mm;

  double reflectance() const { return dipole_reflectance(medium(), 1.4); }
  ShapePoint shape(double pitch_mm) const {
    const double r = reflectance();
    return {std::log(r / (1 - r)), std::log(diffuse_mean_free_path_mm(medium()) / pitch_mm)};
  }

 private:
  Coefficients medium() const { return {sigma_a_per_mm, sigma_s_prime_per_mm}; }
};

// Independent of the library's distributions, which differ.
class Normal {
 public:
  explicit Normal(std::uint64_t seed) : random_(seed) {}
  double uniform() { return (static_cast<double>(random_() >> 11) + 0.5) * 0x1p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  double normal() {
    return std::sqrt(-2 * std::log(uniform())) * std::cos(2 * std::numbers::pi * uniform());
  }

 private:
  std::mt19937_64 random_;
};

inline std::vector<int> even_shifts(int count, int period_px = 40) {
  std::vector<int> shifts;
  for (int i = 0; i < count; ++i) shifts.push_back(i * period_px / count);
  return shifts;
}

// Shared by all pixels of a test, as a session would have it.
struct Sweep {
  StripeShape shape{};
  std::vector<int> shifts_px = even_shifts(40);
  std::vector<MergedNoise> noise = paper_noise();
  Dipole model{1.4};
  double projector_black_frac = 0;
  IndirectLight indirect = IndirectLight::kFree;

  FitProblem problem(const HarmonicTable* table) const {
    return {.shape = shape,
            .shifts_px = shifts_px,
            .noise = noise,
            .projector_black_frac = projector_black_frac,
            .model = &model,
            .table = table,
            .indirect = indirect};
  }
  ReferencePixel reference(double position_px, double full_signal) const {
    ReferencePixel pixel{.period_px = shape.period_px, .width_px = shape.width_px};
    pixel.shifts_px.assign(shifts_px.begin(), shifts_px.end());
    pixel.black_frac = static_cast<Real>(projector_black_frac);
    pixel.position_px = static_cast<Real>(position_px);
    pixel.full_signal = static_cast<Real>(full_signal);
    pixel.noise = noise;
    return pixel;
  }
};

// Samples with noise, as floats.
inline std::vector<float> noisy(const ReferencePixel& pixel, const std::vector<Real>& signals,
                                Normal& random) {
  std::vector<float> samples{};
  for (const Real signal : signals)
    samples.push_back(static_cast<float>(
        static_cast<double>(signal) +
        std::sqrt(static_cast<double>(reference_variance(pixel, signal))) * random.normal()));
  return samples;
}

// A batch of one pixel that borrows its numbers.
struct OnePixel {
  std::vector<float> samples{};
  float position_px = 0, full_signal = 0;
  std::vector<float> factor_re{}, factor_im{}, offset_px{};

  PixelBatch batch() const {
    return {.count = 1,
            .stride = 1,
            .samples = samples,
            .position_px = {&position_px, 1},
            .full_signal = {&full_signal, 1},
            .factor_re = factor_re,
            .factor_im = factor_im,
            .factor_count = static_cast<int>(factor_re.size()),
            .offset_px = offset_px};
  }
};

}  // namespace estimation::testing
