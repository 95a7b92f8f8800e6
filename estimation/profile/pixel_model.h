// One pixel's samples as the model has them, with their derivatives: what its fit and its
// Cramer-Rao bound are made of.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <span>
#include <vector>

#include "estimation/profile/likelihood.h"
#include "estimation/profile/sample_space.h"
#include "estimation/profile/shape_harmonics.h"

namespace estimation {

// What the harmonics n >= 1 add to the reflectance factor of each sample that a pixel has, and its
// derivatives by t, lambda and the phase in px. [sample]
struct ModelSamples {
  std::vector<double> harmonics, by_logit, by_log, by_phase;
};

// Bound to a pixel, then evaluated as often as wanted. Keeps its buffers from pixel to pixel. Not
// thread-safe.
class PixelModel {
 public:
  enum class Binding { kReady, kNoLight, kAbsurd };

  // Takes over those of the pixel's samples that are not NaN; all of them if the batch has no
  // samples. kNoLight: full_signal is not positive; kAbsurd: something is not finite, or huge.
  Binding bind(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel);

  std::size_t sample_count() const { return reflectance_.size(); }
  std::size_t lost_count() const { return problem_->shifts_px.size() - sample_count(); }
  // [sample] the reflectance factors measured.
  std::span<const double> reflectance() const { return reflectance_; }
  // [sample] cosine and sine of n times a sample's own angle, 2 pi / P times its shift: harmonic
  // n = Re[G exp(-i n angle)], G = a_n twice_factor(n) exp(i n origin_rad).
  std::span<const double> cosines(int n);
  std::span<const double> sines(int n);
  // Where the pixel lies in the period, at phase 0.
  double origin_rad() const { return origin_rad_; }
  // f_0 (d + b): what R_d + B is multiplied with in every sample.
  double level() const { return level_; }
  // 2 f_n; 0 beyond the batch's factors.
  std::complex<double> twice_factor(int n) const;
  double wave_per_px() const { return wave_per_px_; }
  // Variance of a sample's reflectance factor where the model expects this much of it: that of
  // variance_at.
  double variance(double reflectance) const;

  using Harmonics = ShapeHarmonics::Extent;

  // False where the model has no value. Harmonics as by ShapeHarmonics::evaluate.
  bool evaluate(ShapePoint shape, double phase_px, double tolerance, Harmonics harmonics,
                ModelSamples& out);
  // 1/2 tr(H C) of each sample, H its second derivatives by t, lambda and phase there, C their
  // covariance by covariance_index: by how much samples of estimates that scatter so are off on
  // average. False where the model has no value.
  bool expected_shift(ShapePoint shape, double phase_px, double tolerance, Harmonics harmonics,
                      const std::array<double, 10>& covariance, std::vector<double>& out);
  // Numbers that the problem lets a fit compare: all samples, or the harmonics that it asks for.
  void choose_space(SampleSpace& space);
  // Whether the table lacked harmonics at the last point.
  bool is_cut_off() const { return harmonics_.is_cut_off(); }

 private:
  // An entry of the problem's noise, for reflectance factors.
  struct Noise {
    double read_variance = 0, shot = 0;
    double end = 0, per_width = 0;
  };
  // Real and imaginary part of G, of the value and its derivatives.
  enum Part { kValueRe, kValueIm, kLogitRe, kLogitIm, kLogRe, kLogIm, kPhaseRe, kPhaseIm, kParts };
  using Bin = std::array<double, kParts>;

  void set_noise();
  void set_waves_of_shifts();
  int most_harmonics() const;
  // Where harmonic n goes, and the sign of its imaginary part there.
  struct Fold {
    std::size_t bin;
    double sign;
  };
  Fold fold_of(int n) const;
  void grow_waves(std::size_t bin_count);
  void fold_harmonics(double phase_px);

  const FitProblem* problem_ = nullptr;
  const PixelBatch* batch_ = nullptr;
  std::size_t pixel_ = 0;
  double full_signal_ = 0, level_ = 0, wave_per_px_ = 0, duty_ = 0, origin_rad_ = 0;
  std::vector<Noise> noise_;
  std::vector<double> reflectance_;
  // Whole shifts share their waves: harmonics n and n + P look alike there.
  bool is_folded_ = false;
  std::vector<int> shifts_px_, shifts_of_waves_px_;  // [sample]
  std::vector<double> angles_rad_;                   // [sample] where shifts are not whole
  std::size_t wave_count_ = 0;                       // bins that the waves hold
  std::vector<double> cosine_, sine_;                // [bin][sample]
  std::vector<double> period_cosine_, period_sine_;  // [px]
  std::vector<Fold> folds_;                          // [n], kept for pixels of the same period
  int fold_period_px_ = 0;
  std::vector<Bin> bins_;
  ShapeHarmonics harmonics_;
};

}  // namespace estimation
