#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <functional>
#include <limits>
#include <string>

#include "estimation/geometry/bend_shift.h"
#include "tests/bench/geometry_bench.h"

namespace bench {
namespace {

// Every sample of every frame once; returned so that nothing is left out.
std::uint64_t read_bare(const GeometrySession& session) {
  std::atomic<std::uint64_t> total = 0;
  tbb::parallel_for(std::size_t{0}, session.frames.size(), [&](std::size_t i) {
    std::uint64_t sum = 0;
    for (const std::uint16_t sample : session.frames[i].samples()) sum += sample;
    total += sum;
  });
  return total;
}

// Of this process: VmRSS, or VmHWM, its peak.
double memory_mb(const std::string& key) {
  std::ifstream status("/proc/self/status");
  std::string word;
  while (status >> word)
    if (word == key + ":") {
      double kb = 0;
      status >> kb;
      return kb / 1024;
    }
  return 0;
}

// From now on the peak is that of what comes.
void forget_peak() { std::ofstream("/proc/self/clear_refs") << 5; }

double frames_mb(const GeometrySession& session) {
  std::size_t bytes = 0;
  for (const auto& frame : session.frames) bytes += frame.samples().size_bytes();
  return static_cast<double>(bytes) / (1 << 20);
}

void add_rows(const GeometrySession& session, const GeometryOptions& options, Table& table,
              Report& report) {
  const auto& manifest = session.manifest;
  std::uint64_t total = 0;
  const double read_ms = least_ms(options.repeats, [&] { total = read_bare(session); });
  if (total == 0) report.fail(session.name + ": the frames are black");
  const PatternFrames frames = frames_by_pattern(session, [](const auto&, double) { return true; });
  const auto frame_views = frames.views();
  const auto correspondence_options = frames.correspondence_options();
  estimation::Correspondence found, moved;
  forget_peak();
  const double before_mb = memory_mb("VmRSS");
  const double decode_ms = least_ms(options.repeats, [&] {
    found =
        estimation::decode_correspondence(frame_views, manifest.projector, correspondence_options);
  });
  estimation::Surface surface;
  const double surface_ms = least_ms(options.repeats, [&] {
    surface = estimation::reconstruct_surface(manifest.calibration, manifest.camera,
                                              manifest.projector, found, {});
  });
  const double bent_ms = least_ms(options.repeats, [&] {
    moved = found;
    surface = estimation::reconstruct_bent_surface(
        frame_views, manifest.calibration, manifest.camera, manifest.projector, {},
        {.levels = correspondence_options.levels}, moved);
  });
  report.text(session.name + ": frames " + digits(frames_mb(session), 4) + " MB; beyond them " +
              digits(memory_mb("VmHWM") - before_mb, 4) +
              " MB at the most for correspondence and surface");
  GeometrySignals signals;
  const double merge_ms = least_ms(options.repeats, [&] { signals = merge_signals(session); });
  const auto views = signals.views();
  const double merged_decode_ms = least_ms(options.repeats, [&] {
    found = estimation::decode_correspondence(views, manifest.projector, signals.options);
  });
  const std::array<std::pair<const char*, double>, 7> steps{
      {{"one bare read of the frames", read_ms},
       {"correspondence from the frames", decode_ms},
       {"surface, once", surface_ms},
       {"surface, bends corrected (three times)", bent_ms},
       {"all from the frames", decode_ms + bent_ms},
       {"merge to signals, as the fit needs them", merge_ms},
       {"correspondence from merged signals", merged_decode_ms}}};
  for (const auto& [name, ms] : steps)
    table.rows.push_back({session.name, name, digits(ms), digits(ms / read_ms)});
}

}  // namespace

void show_geometry_cost(const GeometryOptions& options, Report& report) {
  Table table{"geometry_cost", "Time of the geometry", {"session", "step", "ms", "bare reads"}};
  for (const auto& folder : options.sessions) {
    const auto session = read_geometry_session(folder);
    if (!session) {
      report.fail(session.error().text());
      continue;
    }
    tbb::task_arena(options.thread_count).execute([&] {
      add_rows(*session, options, table, report);
    });
  }
  report.table(table);
}

}  // namespace bench
