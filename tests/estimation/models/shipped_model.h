// The shipped Monte Carlo models by file, for tests.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "estimation/models/monte_carlo.h"
#include "estimation/models/monte_carlo/shipped_tables.h"

namespace estimation::testing {

inline MonteCarlo shipped(std::string_view file_name) {
  for (const ShippedTable& table : shipped_tables())
    if (table.file_name == file_name)
      return MonteCarlo(scattering_table_from_text(table.text, std::string(file_name)).value());
  ADD_FAILURE() << "no table " << file_name;
  return MonteCarlo({});
}

inline double s_of(const Coefficients& medium) {
  const double x = medium.sigma_a_per_mm / medium.sigma_s_prime_per_mm;
  return std::sqrt(3 * x * (1 + x));
}

}  // namespace estimation::testing
