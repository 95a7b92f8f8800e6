// The heights of a stripe profile's harmonics at one shape of the material, from the table or from
// the model itself: what differs from pixel to pixel is left to PixelModel.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "estimation/profile/likelihood.h"

namespace estimation {

// Evaluated as often as wanted; keeps its buffers. Not thread-safe.
class ShapeHarmonics {
 public:
  // kOfTable does without those that a table lacks.
  enum class Extent { kOfTable, kAll };

  // a_n = sinc(n d) d R~(2 pi n / P) and its derivatives at this shape. From the table where that
  // holds the point, and holds all harmonics that matter unless kOfTable does without; those below
  // `tolerance` are left out, and those beyond `most`. False where the model has no value.
  bool evaluate(const FitProblem& problem, int most, ShapePoint shape, double tolerance,
                Extent extent);

  // Second derivatives there, after evaluate(). False where the model has no value.
  bool evaluate_curvature(const FitProblem& problem, ShapePoint shape);

  // Harmonics n = 1..count(), at [n - 1].
  std::size_t count() const { return value_.size(); }
  std::span<const double> value() const { return value_; }
  std::span<const double> by_logit() const { return by_logit_; }
  std::span<const double> by_log() const { return by_log_; }
  std::span<const double> by_logit_twice() const { return by_logit_2_; }
  std::span<const double> by_both() const { return by_both_; }
  std::span<const double> by_log_twice() const { return by_log_2_; }
  // Whether the table lacked harmonics at the last point.
  bool is_cut_off() const { return is_cut_off_; }

 private:
  bool from_table(const FitProblem& problem, int most, ShapePoint shape, double tolerance,
                  Extent extent);
  bool from_model(const FitProblem& problem, int most, ShapePoint shape, double tolerance);
  bool append_from_model(const FitProblem& problem, ShapePoint shape, std::size_t count);
  void curvature_between_nodes(const HarmonicTable& table, ShapePoint shape);
  bool curvature_of_model(const FitProblem& problem, ShapePoint shape);
  void grow_envelope(StripeShape stripes, std::size_t count);
  void set_waves(const FitProblem& problem, ShapePoint shape, std::size_t before, std::size_t count,
                 std::span<const double> log_offsets);

  bool is_cut_off_ = false, is_of_table_ = false;
  std::size_t count_of_model_ = 0;  // at the last point; has no influence on the values
  std::vector<double> value_, by_logit_, by_log_;
  std::vector<double> by_logit_2_, by_both_, by_log_2_;
  StripeShape envelope_of_;
  std::vector<double> envelope_;
  std::vector<double> waves_, plain_, lower_, upper_;
};

}  // namespace estimation
