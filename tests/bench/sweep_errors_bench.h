// Blur and drift that no calibration told of: found in the data of all pixels, and what is left of
// their bias then.
#pragma once

#include "tests/bench/estimation_bench.h"

namespace bench {

void show_estimated_sweep_errors(Bench& bench, const std::vector<NamedMedium>& media);

}  // namespace bench
