// Light from one exact direction into another, by a Monte Carlo walk that shares nothing with the
// tables of monte_carlo and monte_carlo_angular but its random numbers: absorption by weights at
// every collision, and at every collision the part that leaves into the wanted direction.
#pragma once

#include <complex>
#include <cstdint>
#include <vector>

#include "estimation/models/scattering_model.h"

namespace estimation::testing {

struct DirectionalRun {
  double eta = 1.4, anisotropy = 0.8;
  double absorption = 0.1;  // sigma_a / sigma_s'
  Directions directions;
  double k_tmfp = 0.4;     // of the first harmonic, in sigma_s'
  int harmonic_count = 8;  // and its multiples
  std::int64_t photon_count = 100000;
  std::uint64_t seed = 1;
};

// [n] for n = 0..harmonic_count: what a pattern exp(i n k x) reflects from the one direction into
// the other, as radiance times pi over the incident flux: T R~ h with its phase.
struct DirectionalResult {
  std::vector<std::complex<double>> value;
  std::vector<double> se;  // of the real or the imaginary part, the root of their mean square
};
DirectionalResult run_directional(const DirectionalRun& run);

}  // namespace estimation::testing
