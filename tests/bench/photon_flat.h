// Photons in flat phantoms against another Monte Carlo code and published figures.
#pragma once

#include "tests/bench/report.h"

namespace bench {

// All in the caller's oneTBB arena; the same numbers for any number of threads.

// Light from above, all exits: mc_truth_rf.csv.
void show_flat_harmonics(Report& report, int paths);
// Oblique light, all exits: how far the first harmonic comes out shifted.
void show_flat_shift(Report& report, int paths);
// By direction of incidence and exit: tests/data/mc_tilted.csv, a third program's.
void show_flat_directions(Report& report, int paths);

}  // namespace bench
