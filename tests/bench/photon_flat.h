// Photons in flat phantoms against another Monte Carlo code and published figures.
#pragma once

#include "tests/bench/report.h"

namespace bench {

// Oblique light comes out shifted: cheek red, 12 mm, all exits (design/estimation.md, section 1).
struct PublishedShift {
  double incidence_degrees = 0, mm = 0;
};
inline constexpr PublishedShift kPublishedShifts[] = {
    {14, 0.12}, {30, 0.25}, {45, 0.35}, {60, 0.43}};

// All in the caller's oneTBB arena; the same numbers for any number of threads.

// Light from above, all exits: mc_truth_rf.csv.
void show_flat_harmonics(Report& report, int paths);
// Oblique light, all exits: kPublishedShifts.
void show_flat_shift(Report& report, int paths);
// By direction of incidence and exit: tests/data/mc_tilted.csv, a third program's.
void show_flat_directions(Report& report, int paths);

}  // namespace bench
