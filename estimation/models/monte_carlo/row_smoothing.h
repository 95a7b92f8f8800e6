// Takes out of a row of noisy values what cannot be signal, so that the second differences a fit
// takes of the spline through them are the model's.
#pragma once

#include <vector>

namespace estimation {

// The values f that minimise  sum ((f - value) / standard_error)^2 + sum (third difference /
// typical)^2: the most likely ones if third differences are of the order of
// `typical_third_difference`. Where the standard error is well below that, values stay as they are.
class RowSmoothing {
 public:
  RowSmoothing(const std::vector<double>& standard_errors, double typical_third_difference);

  std::vector<double> smooth(const std::vector<double>& values) const;

 private:
  static constexpr std::size_t kBand = 4;  // of the symmetric matrix: the diagonal and three below

  std::vector<double> weights_;
  std::vector<double> factor_;  // Cholesky's, [row][0..3] = L[row][row - 3 .. row]
};

}  // namespace estimation
