// Linear systems of four unknowns, for the fits behind the scattering tables.
#pragma once

#include <array>
#include <cmath>
#include <utility>

namespace estimation {

// Four equations in four unknowns, the right side in the fifth column; Gauss with pivoting.
inline std::array<double, 4> solve(std::array<std::array<double, 5>, 4> rows) {
  for (std::size_t i = 0; i < 4; ++i) {
    std::size_t pivot = i;
    for (std::size_t j = i + 1; j < 4; ++j)
      if (std::abs(rows[j][i]) > std::abs(rows[pivot][i])) pivot = j;
    std::swap(rows[i], rows[pivot]);
    for (std::size_t j = 0; j < 4; ++j) {
      if (j == i) continue;
      const double factor = rows[j][i] / rows[i][i];
      for (std::size_t column = i; column < 5; ++column)
        rows[j][column] -= factor * rows[i][column];
    }
  }
  std::array<double, 4> result{};
  for (std::size_t i = 0; i < 4; ++i) result[i] = rows[i][4] / rows[i][i];
  return result;
}

}  // namespace estimation
