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
  // samples. kNoLight: full_signal is not positive; kAbsurd: something is not finite.
  Binding bind(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel);

  std::size_t sample_count() const { return reflectance_.size(); }
  std::size_t lost_count() const { return problem_->shifts_px.size() - sample_count(); }
  // [sample] the reflectance factors measured.
  std::span<const double> reflectance() const { return reflectance_; }
  // [sample] exp(i n angle) of harmonic n at phase 0.
  std::span<const double> turn_re(int n);
  std::span<const double> turn_im(int n);
  // f_0 (d + b): what R_d + B is multiplied with in every sample.
  double level() const { return level_; }
  // 2 f_n; 0 beyond the batch's factors.
  std::complex<double> twice_factor(int n) const;
  double wave_per_px() const { return wave_per_px_; }
  // Variance of a sample's reflectance factor where the model expects this much of it.
  double variance(double reflectance) const;

  enum class Harmonics { kOfTable, kAll };

  // False where the model has no value. From the table where that holds the point, and holds all
  // harmonics that matter unless kOfTable does without; those below `tolerance` of reflectance are
  // left out.
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
  bool is_cut_off() const { return is_cut_off_; }

 private:
  bool from_table(ShapePoint shape, double tolerance, Harmonics harmonics);
  bool from_model(ShapePoint shape, double tolerance);
  bool append_from_model(ShapePoint shape, int count);
  void curvature_between_nodes(ShapePoint shape);
  bool curvature_from_model(ShapePoint shape, double tolerance);
  int most_harmonics() const;
  void grow_turns(int harmonic_count);
  void add_harmonic(int n, double phase_px, ModelSamples& out);

  const FitProblem* problem_ = nullptr;
  const PixelBatch* batch_ = nullptr;
  std::size_t pixel_ = 0;
  double full_signal_ = 0, level_ = 0, wave_per_px_ = 0, duty_ = 0;
  std::vector<double> reflectance_;
  std::vector<double> turn_re_, turn_im_;  // [n - 1][sample]
  bool is_cut_off_ = false;
  int turn_count_ = 0;                                   // harmonics that the turns hold
  std::vector<double> value_, by_logit_, by_log_;        // [n - 1] a_n and derivatives
  std::vector<double> by_logit_2_, by_both_, by_log_2_;  // [n - 1] second derivatives
  std::vector<double> waves_, plain_, lower_, upper_;
};

}  // namespace estimation
