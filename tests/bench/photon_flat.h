// Photons in flat phantoms against another Monte Carlo code and published figures.
#pragma once

#include "tests/bench/report.h"

namespace bench {

// In the caller's oneTBB arena; the same numbers for any number of threads.
void show_flat(Report& report, int paths);

}  // namespace bench
