// `ssrig-bench estimation`: what the estimator achieves, section by section.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "tests/bench/bound.h"
#include "tests/bench/pixels.h"
#include "tests/bench/report.h"

namespace bench {

inline constexpr double kEta = 1.4;

// What the sections share. Not thread-safe; everything runs in a oneTBB arena of thread_count.
struct Bench {
  Report& report;
  bool is_quick = false;
  int thread_count = 1;
  std::size_t stress_count = 0;  // pixels of the stress test; 0: by is_quick
  std::size_t pixel_count = 0;   // of run time against error; 0: by is_quick

  std::vector<NamedMedium> media = {};  // Table 2
  estimation::truth::DipoleCurves curves{kEta};
  BoundOfTruth bounds{kEta, {}};

  Subject subject(const estimation::Coefficients& medium, double pitch_mm);  // dipole truth
  // All of Table 2 in turn, at the paper's stripes and this pitch.
  PixelPlan plan(double pitch_mm, double indirect, int shift_count, double light_frac,
                 std::size_t count);
};

void show_efficiency(Bench& bench);
void show_run_time_against_error(Bench& bench);
void show_error_budget(Bench& bench);
void show_monte_carlo_truth(Bench& bench);
void show_stability(Bench& bench);
void show_skipping(Bench& bench);
void show_speed(Bench& bench);

// Microseconds a pixel: the median of `repeats` calls after one that does not count.
double time_us(const std::function<void()>& work, std::size_t pixel_count, int repeats);

}  // namespace bench
