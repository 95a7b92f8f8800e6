#include "tests/bench/estimation_bench.h"

#include <algorithm>
#include <chrono>

namespace bench {

Subject Bench::subject(const estimation::Coefficients& medium, double pitch_mm) {
  const auto shape = curves.line_spread(medium).shape();
  return {.curve = &curves.curve(medium, {}, pitch_mm),
          .medium = medium,
          .pitch_mm = pitch_mm,
          .diffuse_reflectance = shape.diffuse_reflectance,
          .translucency_mm = shape.translucency_mm};
}

PixelPlan Bench::plan(double pitch_mm, double indirect, int shift_count, double light_frac,
                      std::size_t count) {
  PixelPlan plan{.subjects = {},
                 .count = count,
                 .shape = {},
                 .shifts_px = even_shifts(40, shift_count),
                 .sensor = {.light_frac = light_frac},
                 .view = {.indirect = indirect}};
  for (const NamedMedium& named : media) plan.subjects.push_back(subject(named.medium, pitch_mm));
  return plan;
}

double time_us(const std::function<void()>& work, std::size_t pixel_count, int repeats) {
  using Clock = std::chrono::steady_clock;
  work();
  std::vector<double> times;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    const auto start = Clock::now();
    work();
    times.push_back(std::chrono::duration<double, std::micro>(Clock::now() - start).count());
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2] / static_cast<double>(pixel_count);
}

}  // namespace bench
