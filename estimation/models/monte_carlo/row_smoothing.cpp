#include "estimation/models/monte_carlo/row_smoothing.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace estimation {

RowSmoothing::RowSmoothing(const std::vector<double>& standard_errors,
                           double typical_third_difference)
    : factor_(kBand * standard_errors.size()) {
  const std::size_t count = standard_errors.size();
  for (double error : standard_errors) {
    // A node without noise holds its value; more weight than this would only cost digits.
    const double bounded = std::max(error, 1e-4 * typical_third_difference);
    weights_.push_back(1 / (bounded * bounded));
  }
  const auto element = [&](std::size_t row, std::size_t column) -> double& {
    return factor_[kBand * row + (kBand - 1) - (row - column)];
  };
  for (std::size_t i = 0; i < count; ++i) element(i, i) = weights_[i];
  constexpr std::array<double, 4> kThirdDifference = {-1, 3, -3, 1};
  const double stiffness = 1 / (typical_third_difference * typical_third_difference);
  for (std::size_t i = 0; i + 3 < count; ++i)
    for (std::size_t a = 0; a < 4; ++a)
      for (std::size_t b = 0; b <= a; ++b)
        element(i + a, i + b) += stiffness * kThirdDifference[a] * kThirdDifference[b];
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t first = i < 3 ? 0 : i - 3;
    for (std::size_t j = first; j <= i; ++j) {
      double sum = element(i, j);
      for (std::size_t m = first; m < j; ++m)
        if (m + 3 >= j) sum -= element(i, m) * element(j, m);
      element(i, j) = i == j ? std::sqrt(sum) : sum / element(j, j);
    }
  }
}

std::vector<double> RowSmoothing::smooth(const std::vector<double>& values) const {
  const std::size_t count = values.size();
  const auto element = [&](std::size_t row, std::size_t column) {
    return factor_[kBand * row + (kBand - 1) - (row - column)];
  };
  std::vector<double> f(count);
  for (std::size_t i = 0; i < count; ++i) {
    double sum = weights_[i] * values[i];
    for (std::size_t j = i < 3 ? 0 : i - 3; j < i; ++j) sum -= element(i, j) * f[j];
    f[i] = sum / element(i, i);
  }
  for (std::size_t i = count; i-- > 0;) {
    for (std::size_t j = i + 1; j < std::min(count, i + 4); ++j) f[i] -= element(j, i) * f[j];
    f[i] /= element(i, i);
  }
  return f;
}

}  // namespace estimation
