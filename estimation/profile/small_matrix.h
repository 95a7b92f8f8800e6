// Symmetric positive definite matrices of a handful of unknowns.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>

namespace estimation {

template <std::size_t N>
using SmallMatrix = std::array<std::array<double, N>, N>;

// Square root of a symmetric matrix scaled to a unit diagonal; scale[i] = 1 / sqrt(diagonal).
template <std::size_t N>
struct ScaledCholesky {
  SmallMatrix<N> lower{};
  std::array<double, N> scale{};

  // Solves matrix * x = right.
  std::array<double, N> solve(std::array<double, N> x) const {
    for (std::size_t i = 0; i < N; ++i) {
      x[i] *= scale[i];
      for (std::size_t k = 0; k < i; ++k) x[i] -= lower[i][k] * x[k];
      x[i] /= lower[i][i];
    }
    for (std::size_t i = N; i-- > 0;) {
      for (std::size_t k = i + 1; k < N; ++k) x[i] -= lower[k][i] * x[k];
      x[i] /= lower[i][i];
    }
    for (std::size_t i = 0; i < N; ++i) x[i] *= scale[i];
    return x;
  }
};

// nullopt where the matrix is not positive definite to within rounding.
template <std::size_t N>
std::optional<ScaledCholesky<N>> scaled_cholesky(const SmallMatrix<N>& matrix) {
  constexpr double kLeastPivot = 1e-13;
  ScaledCholesky<N> root;
  for (std::size_t i = 0; i < N; ++i) {
    if (!(matrix[i][i] > 0 && matrix[i][i] < std::numeric_limits<double>::max()))
      return std::nullopt;
    root.scale[i] = 1 / std::sqrt(matrix[i][i]);
  }
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = matrix[i][j] * root.scale[i] * root.scale[j];
      for (std::size_t k = 0; k < j; ++k) sum -= root.lower[i][k] * root.lower[j][k];
      if (i != j)
        root.lower[i][j] = sum / root.lower[j][j];
      else if (sum > kLeastPivot)
        root.lower[i][i] = std::sqrt(sum);
      else
        return std::nullopt;
    }
  return root;
}

template <std::size_t N>
std::optional<SmallMatrix<N>> inverse_of(const SmallMatrix<N>& matrix) {
  const auto root = scaled_cholesky(matrix);
  if (!root) return std::nullopt;
  SmallMatrix<N> inverse;
  for (std::size_t i = 0; i < N; ++i) {
    std::array<double, N> unit{};
    unit[i] = 1;
    inverse[i] = root->solve(unit);
  }
  return inverse;
}

// Largest over smallest eigenvalue after scaling to a unit diagonal; by Jacobi's rotations.
template <std::size_t N>
double condition_of(SmallMatrix<N> matrix) {
  std::array<double, N> scale;
  for (std::size_t i = 0; i < N; ++i) scale[i] = 1 / std::sqrt(matrix[i][i]);
  for (std::size_t i = 0; i < N; ++i)
    for (std::size_t j = 0; j < N; ++j) matrix[i][j] *= scale[i] * scale[j];
  for (int sweep = 0; sweep < 12; ++sweep)
    for (std::size_t p = 0; p < N; ++p)
      for (std::size_t q = p + 1; q < N; ++q) {
        if (matrix[p][q] == 0) continue;
        const double theta = (matrix[q][q] - matrix[p][p]) / (2 * matrix[p][q]);
        const double tangent = std::copysign(1 / (std::abs(theta) + std::hypot(theta, 1)), theta);
        const double cosine = 1 / std::hypot(tangent, 1), sine = tangent * cosine;
        for (std::size_t k = 0; k < N; ++k) {
          const double kp = matrix[k][p], kq = matrix[k][q];
          matrix[k][p] = cosine * kp - sine * kq;
          matrix[k][q] = sine * kp + cosine * kq;
        }
        for (std::size_t k = 0; k < N; ++k) {
          const double pk = matrix[p][k], qk = matrix[q][k];
          matrix[p][k] = cosine * pk - sine * qk;
          matrix[q][k] = sine * pk + cosine * qk;
        }
      }
  double least = matrix[0][0], greatest = matrix[0][0];
  for (std::size_t i = 1; i < N; ++i) {
    least = std::min(least, matrix[i][i]);
    greatest = std::max(greatest, matrix[i][i]);
  }
  return least > 0 ? greatest / least : std::numeric_limits<double>::infinity();
}

}  // namespace estimation
