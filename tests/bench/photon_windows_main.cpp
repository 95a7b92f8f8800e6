// photon-windows: the simulator's surface light transport and the estimator's assumptions against
// photons through the volume, in windows of a face and on flat phantoms. Figures: RESULTS.md.
#include <tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <string>
#include <vector>

#include "hw_sim/world/head_world.h"
#include "tests/bench/photon_curvature.h"
#include "tests/bench/photon_flat.h"
#include "tests/bench/photon_tables.h"
#include "tests/bench/scatter_bench.h"

namespace {

using hw_sim::Region;

const std::vector<bench::WindowPlan> kWindows = {
    // Nothing varies and nothing bends: what the ways' own errors are.
    {"phantom", "flat phantom", "flat_phantom", Region::kNone, 215, 293, 16, 16},
    {"cheek", "cheek (face_female)", "face_female", Region::kNone, 283, 222},
    {"lip", "lip's edge (face_female)", "face_female", Region::kLips, 357, 305},
    {"stubble", "stubble's border (face_male)", "face_male", Region::kStubble, 309, 245},
    {"nostril", "nostril (face_female)", "face_female", Region::kNone, 302, 284},
};

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Photons through the volume as the judge of the simulator and of the estimator.");
  std::string folder, cache = hw_sim::default_cache_folder().string();
  std::vector<std::string> only;
  bench::WindowOptions options;
  int flat_paths = 200'000;
  app.add_option("--out", folder, "Folder for CSV and PNG")->required();
  app.add_option("--only", only,
                 "flat, shift, directions, table, curvature, or windows by name; comma-separated")
      ->delimiter(',');
  app.add_option("--paths", options.paths_per_sample, "Paths a camera pixel")
      ->check(CLI::Range(16, 10'000'000));
  app.add_option("--flat-paths", flat_paths, "Paths a flat phantom");
  app.add_option("--photons", options.photons_per_angle, "Of the simulator's table, an angle");
  app.add_option("--threads", options.thread_count, "Threads to use")->check(CLI::Range(1, 1024));
  app.add_option("--cache", cache, "Folder of the surface way's tables");
  app.add_flag("--indirect", options.has_indirect, "Light between parts of the face, both ways");
  CLI11_PARSE(app, argc, argv);
  options.cache_folder = cache;
  const auto is_wanted = [&](const std::string& name) {
    return only.empty() || std::find(only.begin(), only.end(), name) != only.end();
  };
  bench::Report report(folder);
  tbb::task_arena arena(options.thread_count);
  if (is_wanted("flat")) arena.execute([&] { bench::show_flat_harmonics(report, flat_paths); });
  if (is_wanted("shift")) arena.execute([&] { bench::show_flat_shift(report, flat_paths); });
  if (is_wanted("directions"))
    arena.execute([&] { bench::show_flat_directions(report, flat_paths); });
  if (is_wanted("table"))
    arena.execute([&] {
      bench::show_scatter_table(report, options.cache_folder, options.photons_per_angle);
    });
  if (is_wanted("curvature")) bench::show_curvature(report, options);
  std::vector<bench::WindowResult> results;
  for (const bench::WindowPlan& plan : kWindows) {
    if (!is_wanted(plan.name)) continue;
    results.push_back(bench::judge(bench::measure(plan, options), options));
    bench::show_window(report, results.back(), folder);
  }
  bench::write_sheet(report, results, folder);
  return report.has_failed() ? 1 : 0;
}
