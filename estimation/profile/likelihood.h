// Joint maximum likelihood of a pixel's material: R_d, l_d, indirect light B and the sub-pixel
// phase from the samples of a stripe sweep, with their covariance (design/estimation.md, sections 1
// and 3).
//
// The model of sample j at shift s_j, as a reflectance factor (signal / full_signal):
//   r_j = f_0 (d + b) (R_d + B) + 2 sum_n d sinc(n d) R~(2 pi n / P) Re[f_n exp(2 pi i n x_j / P)]
//   x_j = position + phase - s_j - offset_j - (w - 1)/2,   d = w / P
// b the projector's black relative to white, f_n the optics' contrast times the model's direction
// factor, lengths in projector px. B is the indirect light's share on the scale of R_d, f_0
// included.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/harmonic_table.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/noise.h"

namespace estimation {

enum class IndirectLight { kFree, kZero };

// What all pixels of a band share. Everything borrowed must outlive the fits.
struct FitProblem {
  StripeShape shape;
  std::span<const int> shifts_px;      // one a sample; any subset, duplicates allowed
  std::span<const MergedNoise> noise;  // of a merged sample, by signal in DN/us
  double projector_black_frac = 0;     // b
  const ScatteringModel* model = nullptr;
  const HarmonicTable* table = nullptr;  // of `model` and `shape`, over what the scene occupies
  // Of the data, used at most: the mean and these harmonics of them, least squares without weights,
  // are fitted by the same of the whole model. 0, or where the shifts hold no more: all samples.
  int harmonic_count = 0;
  IndirectLight indirect = IndirectLight::kFree;
};

// Pixels as structures of arrays: element i of each row belongs to pixel i < count. Rows of several
// quantities lie `stride` apart; stride >= count is a multiple of 16, what lies beyond count is
// finite.
struct PixelBatch {
  std::size_t count = 0;
  std::size_t stride = 0;
  std::span<const float> samples;      // [shift][stride] DN/us, camera black removed; NaN: lost
  std::span<const float> position_px;  // [stride] projector coordinate along the stripes' axis
  std::span<const float>
      full_signal;  // [stride] DN/us of a perfect reflector under full light there
  // [n = 0..K][stride] real and imaginary part of f_n, K >= the harmonics used; [n] if all pixels
  // share them; both empty: 1
  std::span<const float> factor_re, factor_im;
  int factor_count = 0;  // K + 1
  // what to add to the shifts: [shift] for all pixels alike, or [shift][stride]; empty: nothing
  std::span<const float> offset_px;

  bool has_shared_factors() const {
    return factor_re.size() == static_cast<std::size_t>(factor_count);
  }
};

// Order of the covariance: 0 t = ln(R_d / (1 - R_d)), 1 ln l_d, 2 B, 3 phase in projector px.
inline constexpr std::size_t kUnknowns = 4;
constexpr std::size_t covariance_index(std::size_t row, std::size_t col) {
  return row >= col ? row * (row + 1) / 2 + col : col * (col + 1) / 2 + row;
}

// R_d, l_d, B and phase have no bias to second order in the noise: t and ln l_d are those of R_d
// and l_d, such that t itself is off by (R_d - 1/2) Var(t) and ln l_d by -1/2 Var(ln l_d). The
// correction is at most half a standard deviation; chi-square is that of the greatest likelihood.
struct PixelFit {
  double logit_reflectance = 0;         // t
  double log_translucency_px = 0;       // ln(l_d / projector px)
  double indirect = 0;                  // B
  double phase_px = 0;                  // to be added to position
  std::array<double, 10> covariance{};  // lower triangle, covariance_index; zero rows if fixed
  double chi_square = 0;
  int degrees_of_freedom = 0;
  // kSaturated, kTooDark, kOutsideModel, kNotIdentifiable: the numbers mean nothing; else 0
  std::uint32_t validity = 0;
};

// The same for many pixels: [i], and [covariance_index][stride] for the covariance.
struct BatchFit {
  std::size_t stride = 0;
  std::vector<float> logit_reflectance, log_translucency_px, indirect, phase_px;
  std::vector<float> covariance, reduced_chi_square;
  std::vector<std::uint32_t> validity;
  void resize(std::size_t stride_wanted);
};

// One pixel, in double precision, by the samples themselves: any shifts, lost samples, any
// material. The reference of the vector code and its way out. Thread-safe.
PixelFit fit_pixel(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel);

// The same for batches of a band's pixels: vectors of them (Highway) wherever the table holds the
// material, fit_pixel for the few that need it. Same estimate as fit_pixel's, in single precision.
// Immutable once built, thread-safe. A pixel's bits depend neither on its neighbours in the batch
// nor on the thread; another family of processors may differ in the last ones.
class BatchFitter {
 public:
  // Some milliseconds: where each pair of first harmonics starts, once per problem. Everything
  // that the problem borrows must outlive the fitter.
  explicit BatchFitter(const FitProblem& problem);
  BatchFitter(BatchFitter&& other) noexcept;
  BatchFitter& operator=(BatchFitter&& other) noexcept;
  ~BatchFitter();

  // Elements from batch.count on hold nothing. No allocation once `fit` has its size.
  void fit(const PixelBatch& batch, BatchFit& fit) const;

 private:
  class Prepared;
  std::unique_ptr<const Prepared> prepared_;
};

// One batch alone.
void fit_batch(const FitProblem& problem, const PixelBatch& batch, BatchFit& fit);

}  // namespace estimation
