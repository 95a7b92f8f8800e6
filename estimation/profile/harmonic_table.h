// The model's harmonics for one kind of stripes as a smooth surface over the two unknowns that
// shape a profile: a fit needs values and derivatives, thousands of times a millisecond.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/stripe_set.h"

namespace estimation {

// t = ln(R_d / (1 - R_d)) and lambda = ln(l_d / projector px): both ends of R_d keep their digits.
struct ShapePoint {
  double logit_reflectance = 0;
  double log_translucency_px = 0;
};

struct ShapeRange {
  ShapePoint least{-6, -3};
  ShapePoint greatest{6, 4.5};
};

// Immutable once built, thread-safe.
class HarmonicTable {
 public:
  static constexpr std::size_t kTerms = 6;

  // Fills the table in the caller's oneTBB arena; the same bits for any number of threads.
  HarmonicTable(const ScatteringModel& model, StripeShape shape, const ShapeRange& range,
                int harmonic_count);

  // Node (row, col) lies at least + (row * logit_step, col * log_step). Its Taylor terms of
  //   a_n = d sinc(n d) R~(2 pi n / P),  n = 1..harmonic_count,
  // as [term][harmonic_stride]: value, d/dt, d/dlambda, 1/2 d2/dt2, d2/dt dlambda, 1/2 d2/dlambda2.
  std::span<const float> node(int row, int col) const;

  int rows() const { return rows_; }
  int cols() const { return cols_; }
  double logit_step() const { return logit_step_; }
  double log_step() const { return log_step_; }
  int harmonic_count() const { return harmonic_count_; }
  std::size_t harmonic_stride() const { return harmonic_stride_; }
  const ShapeRange& range() const { return range_; }
  bool holds(ShapePoint point) const;
  StripeShape shape() const { return shape_; }

 private:
  StripeShape shape_;
  ShapeRange range_;
  int rows_ = 0, cols_ = 0, harmonic_count_ = 0;
  std::size_t harmonic_stride_ = 0;
  double logit_step_ = 0, log_step_ = 0;
  std::vector<float> terms_;  // [row][col][term][harmonic_stride]
};

}  // namespace estimation
