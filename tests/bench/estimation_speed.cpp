// Full size: what merging and fitting a sweep cost, and what each thing that is left out saves.
#include <oneapi/tbb/global_control.h>

#include <array>
#include <cstdio>

#include "tests/bench/estimation_bench.h"
#include "tests/bench/fit_speed.h"

namespace bench {
namespace {

constexpr double kBareReadsAsked = 12;

SpeedOptions options_for(const Bench& bench) {
  SpeedOptions options;
  if (bench.is_quick) {
    options.height_px /= 4;
    options.width_px /= 4;
    options.repetitions = 3;
  }
  return options;
}

// What the report states as its threads.
tbb::global_control limit_of(const Bench& bench) {
  return {tbb::global_control::max_allowed_parallelism,
          static_cast<std::size_t>(bench.thread_count)};
}

const SpeedStage& total_of(const SpeedReport& report) { return report.stages.back(); }

}  // namespace

void show_speed(Bench& bench) {
  const auto limit = limit_of(bench);
  const SpeedOptions options = options_for(bench);
  const SpeedReport report = speed_report(options);
  bench.report.text(std::to_string(options.width_px)
                        .append(" x ")
                        .append(std::to_string(options.height_px))
                        .append(", 40 stripes x 2 exposures in memory, ")
                        .append(percent(options.valid_frac, 0))
                        .append("% of the pixels valid, ")
                        .append(std::to_string(report.thread_count))
                        .append(" threads. Asked for: ")
                        .append(digits(kBareReadsAsked))
                        .append(" bare reads in all; measured ")
                        .append(digits(total_of(report).bare_reads))
                        .append("."));
  bench.report.text(to_text(report));
  Table table{.name = "speed", .title = "", .columns = {"stage", "ms", "bare reads"}};
  for (const SpeedStage& stage : report.stages)
    table.rows.push_back({stage.name, digits(stage.milliseconds, 4), digits(stage.bare_reads)});
  bench.report.table(table, false);
}

void show_skipping(Bench& bench) {
  const auto limit = limit_of(bench);
  struct Switch {
    const char* name;
    void (*set)(SpeedOptions&);
  };
  static constexpr std::array kSwitches{
      Switch{"default", [](SpeedOptions&) {}},
      Switch{"background fitted, too", [](SpeedOptions& o) { o.is_background_fitted = true; }},
      Switch{"40 harmonics, below the noise, too", [](SpeedOptions& o) { o.harmonic_count = 40; }},
      Switch{"at most 8 harmonics", [](SpeedOptions& o) { o.harmonic_count = 8; }},
      Switch{"at most 4 harmonics", [](SpeedOptions& o) { o.harmonic_count = 4; }},
      Switch{"table over every material", [](SpeedOptions& o) { o.is_table_wide = true; }},
      Switch{"B fixed at zero", [](SpeedOptions& o) { o.is_indirect_free = false; }}};
  Table table{.name = "skip",
              .title = "What leaving out saves (half the full size on a side)",
              .columns = {"switch", "fit, ms", "total, ms", "tables beforehand, ms",
                          "total over default's"}};
  double default_ms = 0;
  for (const Switch& one : kSwitches) {
    SpeedOptions options = options_for(bench);
    if (!bench.is_quick) {
      options.height_px /= 2;
      options.width_px /= 2;
    }
    one.set(options);
    const SpeedReport report = speed_report(options);
    const double total_ms = total_of(report).milliseconds;
    if (default_ms == 0) default_ms = total_ms;
    const double fit_ms = report.stages[report.stages.size() - 2].milliseconds;
    table.rows.push_back({one.name, digits(fit_ms, 4), digits(total_ms, 4),
                          digits(report.prepare_ms), digits(total_ms / default_ms)});
  }
  bench.report.table(table);
}

}  // namespace bench
