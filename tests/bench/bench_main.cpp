// ssrig-bench: measures on this machine what RESULTS.md states.
#include <oneapi/tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <fstream>
#include <iostream>
#include <set>
#include <string>
#include <thread>

#include "tests/bench/estimation_bench.h"
#include "tests/bench/geometry_bench.h"

namespace {

struct Section {
  const char* name;
  const char* title;
  void (*show)(bench::Bench&);
};
constexpr Section kSections[] = {
    {"efficiency", "Efficiency", bench::show_efficiency},
    {"pareto", "Run time against error", bench::show_run_time_against_error},
    {"budget", "Error budget", bench::show_error_budget},
    {"truth", "Monte Carlo truth", bench::show_monte_carlo_truth},
    {"stability", "Numerical stability", bench::show_stability},
    {"skip", "What is not needed", bench::show_skipping},
    {"speed", "Full size", bench::show_speed},
};

std::string processor() {
  std::ifstream stream("/proc/cpuinfo");
  for (std::string line; std::getline(stream, line);)
    if (line.starts_with("model name")) return line.substr(line.find(':') + 2);
  return "unknown processor";
}

int run_estimation(const std::string& folder, bool is_quick, int threads, std::size_t stress_count,
                   std::size_t pixel_count, const std::vector<std::string>& only) {
  bench::Report report(folder);
  bench::Bench shared{.report = report,
                      .is_quick = is_quick,
                      .thread_count = threads,
                      .stress_count = stress_count,
                      .pixel_count = pixel_count};
  shared.media = bench::table_2(SSRIG_TEST_DATA "/tariq2006_table2.csv");
  report.text(std::string("## Estimation\n\n")
                  .append(processor())
                  .append(", ")
                  .append(std::to_string(std::thread::hardware_concurrency()))
                  .append(" threads in the machine, ")
                  .append(std::to_string(threads))
                  .append(" used")
                  .append(is_quick ? "; quick run." : "."));
  tbb::task_arena(threads).execute([&] {
    for (const Section& section : kSections) {
      if (!only.empty() && std::find(only.begin(), only.end(), section.name) == only.end())
        continue;
      report.text(std::string("### ").append(section.title));
      section.show(shared);
    }
  });
  return report.has_failed() ? 1 : 0;
}

struct GeometrySection {
  const char* name;
  const char* title;
  void (*show)(const bench::GeometryOptions&, bench::Report&);
};
constexpr GeometrySection kGeometrySections[] = {
    {"decoders", "OpenCV's Gray-code decoder", bench::show_gray_decoders},
    {"accuracy", "Correspondence, position, normals", bench::show_geometry_accuracy},
    {"cost", "Time and memory", bench::show_geometry_cost},
};

int run_geometry(const std::string& folder, const bench::GeometryOptions& options) {
  bench::Report report(folder);
  report.text(std::string("## Geometry\n\n")
                  .append(processor())
                  .append(", ")
                  .append(std::to_string(options.thread_count))
                  .append(" threads"));
  for (const GeometrySection& section : kGeometrySections) {
    const auto& only = options.only;
    if (!only.empty() && std::find(only.begin(), only.end(), section.name) == only.end()) continue;
    report.text(std::string("### ").append(section.title));
    section.show(options, report);
  }
  return report.has_failed() ? 1 : 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("What ssrig is worth, measured on this machine.");
  app.require_subcommand(1);
  CLI::App* estimation = app.add_subcommand("estimation", "Run time against error, and the checks");
  std::string folder;
  bool is_quick = false;
  int threads = static_cast<int>(std::thread::hardware_concurrency());
  std::size_t stress_count = 0, pixel_count = 0;
  std::vector<std::string> only;
  std::set<std::string> names;
  for (const Section& section : kSections) names.insert(section.name);
  estimation->add_option("--out", folder, "Folder for CSV, SVG and PNG")->required();
  estimation->add_flag("--quick", is_quick, "A tenth of the cases and pixels");
  estimation->add_option("--threads", threads, "Threads to use")->check(CLI::Range(1, 1024));
  estimation->add_option("--stress-pixels", stress_count, "Pixels of the stress test");
  estimation->add_option("--pixels", pixel_count, "Pixels of run time against error");
  estimation->add_option("--only", only, "Sections to run, comma-separated")
      ->delimiter(',')
      ->check(CLI::IsMember(names));
  bench::GeometryOptions geometry_options{.thread_count = threads};
  CLI::App* geometry = app.add_subcommand("geometry", "Correspondence and surface against truth");
  geometry->add_option("--out", folder, "Folder for CSV and PNG")->required();
  geometry
      ->add_option("--session", geometry_options.sessions,
                   "Sessions of the virtual rig, their truth beside their maps")
      ->required();
  geometry->add_option("--threads", geometry_options.thread_count, "Threads to use")
      ->check(CLI::Range(1, 1024));
  geometry->add_option("--repeats", geometry_options.repeats, "Runs of which the best is timed")
      ->check(CLI::Range(1, 1000));
  geometry->add_option("--only", geometry_options.only, "Sections to run, comma-separated")
      ->delimiter(',');
  CLI11_PARSE(app, argc, argv);
  if (geometry->parsed()) {
    geometry_options.out = folder;
    return run_geometry(folder, geometry_options);
  }
  return run_estimation(folder, is_quick, threads, stress_count, pixel_count, only);
}
