// Both sources of the dipole at many attenuations, by the widest vectors the processor has: a table
// of profiles is millions of them.
#pragma once

#include <span>

namespace estimation {

// out[i] = factor/2 (exp(-Q) + exp(-farther Q)), Q = s sqrt(1 + x[i]^2), to a few
// roundings of Q and of the result; x and out of the same length. farther >= 1 and s >= 0.
void source_pairs(double factor, double s, double farther, std::span<const double> x,
                  std::span<double> out);

}  // namespace estimation
