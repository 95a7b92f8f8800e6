// What the estimator makes of a window's signals, whichever light transport gave them.
#pragma once

#include <vector>

#include "tests/bench/photon_window.h"

namespace bench {

struct Recovered {
  double sigma_a_per_mm = 0, sigma_s_prime_per_mm = 0, translucency_mm = 0;
  bool is_valid = false;
};

// One a pixel, of its own band. Frames of two exposures in whole DN, without noise, go through the
// product's estimator as `ssrig estimate --model monte_carlo_angular` runs it. Ends the program on
// an error.
std::vector<Recovered> recover(const Window& window, const Signals& signals, int thread_count);

}  // namespace bench
