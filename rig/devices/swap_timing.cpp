#include "rig/devices/swap_timing.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <utility>

#include "rig/devices/projector_monitor.h"

namespace rig {
namespace {

constexpr double kPeriodTolerance_frac = 0.1;  // Psychtoolbox' limit for measured against nominal

std::string fixed(double value, int decimals) {
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%.*f", decimals, value);
  return text.data();
}

struct IntervalStatistics {
  double median_ms = 0, sd_ms = 0, max_ms = 0;
};

IntervalStatistics summarise(std::vector<double> intervals_ms) {
  std::sort(intervals_ms.begin(), intervals_ms.end());
  double sum_ms = 0;
  for (const double interval_ms : intervals_ms) sum_ms += interval_ms;
  const double mean_ms = sum_ms / static_cast<double>(intervals_ms.size());
  double sum_of_squares = 0;
  for (const double interval_ms : intervals_ms)
    sum_of_squares += (interval_ms - mean_ms) * (interval_ms - mean_ms);
  return {intervals_ms[intervals_ms.size() / 2],
          std::sqrt(sum_of_squares / static_cast<double>(intervals_ms.size())),
          intervals_ms.back()};
}

// The median, because a busy computer stretches some intervals of a synchronised display too.
// A monitor that does not tell its rate counts as synchronised if the swaps keep time at a rate
// that a monitor can have.
bool intervals_are_of_monitor(const IntervalStatistics& measured, double nominal_hz) {
  if (nominal_hz > 0)
    return std::abs(measured.median_ms * nominal_hz / 1000.0 - 1.0) < kPeriodTolerance_frac;
  return measured.median_ms > 1000.0 / 250.0 && measured.median_ms < 1000.0 / 20.0 &&
         measured.sd_ms < kPeriodTolerance_frac * measured.median_ms;
}

}  // namespace

void judge_swaps(std::vector<double> intervals_ms, DisplayReport& report) {
  const IntervalStatistics measured = summarise(std::move(intervals_ms));
  report.measured_refresh_hz = 1000.0 / std::max(measured.median_ms, 1e-3);
  report.interval_sd_ms = measured.sd_ms;
  report.interval_max_ms = measured.max_ms;
  report.is_vsynced = intervals_are_of_monitor(measured, report.nominal_refresh_hz);
}

std::string describe(const DisplayReport& report) {
  const std::string nominal = report.nominal_refresh_hz > 0
                                  ? fixed(report.nominal_refresh_hz, 0) + " Hz nominal"
                                  : "nominal rate unknown";
  return "monitor " + report.monitor + ", " + size_text(report.width_px, report.height_px) +
         " px, " + (report.is_vsynced ? "synchronised" : "not synchronised: swaps") + " at " +
         fixed(report.measured_refresh_hz, 2) + " Hz (" + nominal + "; interval sd " +
         fixed(report.interval_sd_ms, 2) + " ms, longest " + fixed(report.interval_max_ms, 1) +
         " ms)" +
         (report.is_vsynced ? "" : "; turn vertical sync on in the driver and the compositor off") +
         ", gamma ramp " +
         (report.is_gamma_identity ? "identity" : "not identity and cannot be set") + ", " +
         report.renderer;
}

}  // namespace rig
