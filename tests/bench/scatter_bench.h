// The simulator's table of scattered light against programs that share nothing with it: figures of
// a photon count that tests have no time for.
#pragma once

#include <filesystem>

#include "tests/bench/report.h"

namespace bench {

// In the caller's oneTBB arena. `cache`: where the world's table is, or will be.
void show_scatter_table(Report& report, const std::filesystem::path& cache, int photons_per_angle);

}  // namespace bench
