// fit-speed: what merging and fitting a full-size sweep costs, with what each thing left out saves.
#include <oneapi/tbb/global_control.h>

#include <CLI/CLI.hpp>
#include <cstdio>

#include "tests/bench/fit_speed.h"

int main(int argc, char** argv) {
  CLI::App app("Merging and fitting a full-size sweep, in bare reads of its frames.");
  bench::SpeedOptions options;
  int threads = 4;
  bool is_indirect_zero = false;
  app.add_option("--threads", threads)->check(CLI::Range(1, 1024));
  app.add_option("--height", options.height_px);
  app.add_option("--width", options.width_px);
  app.add_option("--repetitions", options.repetitions)->check(CLI::Range(1, 1000));
  app.add_option("--harmonics", options.harmonic_count, "At most; 0: what rises above the noise");
  app.add_option("--valid", options.valid_frac, "Share of the pixels that are valid");
  app.add_flag("--indirect-zero", is_indirect_zero, "B = 0 instead of free");
  app.add_flag("--wide-table", options.is_table_wide, "A table over every material");
  app.add_flag("--fit-background", options.is_background_fitted, "Pass no pixel over");
  CLI11_PARSE(app, argc, argv);
  options.is_indirect_free = !is_indirect_zero;
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                  static_cast<std::size_t>(threads));
  std::fputs(bench::to_text(bench::speed_report(options)).c_str(), stdout);
  return 0;
}
