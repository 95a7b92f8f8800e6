// Whether frames that do not show their pattern are found, and none that does is accused.
//   picture-checks session SESSION            each slot of a stored session made wrong in turn
//   picture-checks simulate RIG [--captures N] [--effects FILE] [--blink-ms T] [--cycle-ms T]
//                                             false alarms over a simulated face
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "estimation/motion/picture_identity.h"
#include "estimation/motion/picture_samples.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world/effects.h"
#include "tests/bench/picture_swaps.h"
#include "tests/bench/scene_frames.h"

namespace {

using std::chrono::steady_clock;

double seconds_since(steady_clock::time_point begin) {
  return std::chrono::duration<double>(steady_clock::now() - begin).count();
}

void print_check(const estimation::PictureCheck& check) {
  std::printf("%s\n", check.text().c_str());
  for (const auto& each : check.unchecked)
    std::printf("  unchecked: pattern %d bracket %d: %s\n", each.pattern, each.bracket,
                each.why.c_str());
}

void print_swaps(const estimation::CameraInfo& camera,
                 const std::vector<estimation::Pattern>& patterns,
                 const std::vector<estimation::SeenPicture>& pictures,
                 const std::vector<double>& shares_frac) {
  for (const double share_frac : shares_frac) {
    const bench::SwapTally tally = bench::try_swaps(camera, patterns, pictures, share_frac);
    std::printf(
        "%3.0f%% of the picture before: %d of %d slots found (%d could be checked), %d of them "
        "named alone, %d told of by nothing\n",
        100 * share_frac, tally.found_count, tally.slot_count, tally.checked_count,
        tally.alone_count, tally.undetected_count);
    for (const std::string& missed : tally.missed) std::printf("  missed: %s\n", missed.c_str());
  }
}

int check_session(const std::string& session, const std::vector<double>& shares_frac) {
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) {
    std::fprintf(stderr, "picture-checks: %s\n", manifest.error().text().c_str());
    return 1;
  }
  const estimation::PictureSampler sampler(manifest->camera);
  std::vector<double> exposures_us;
  for (const auto& frame : manifest->frames) exposures_us.push_back(frame.exposure_us);
  std::sort(exposures_us.begin(), exposures_us.end());
  exposures_us.erase(std::unique(exposures_us.begin(), exposures_us.end()), exposures_us.end());
  std::vector<estimation::SeenPicture> pictures;
  double sampling_s = 0;
  for (const auto& frame : manifest->frames) {
    const auto dn = estimation::read_frame(session, *manifest, frame.file);
    if (!dn) {
      std::fprintf(stderr, "picture-checks: %s\n", dn.error().text().c_str());
      return 1;
    }
    const auto place = std::find(exposures_us.begin(), exposures_us.end(), frame.exposure_us);
    const auto begin = steady_clock::now();
    pictures.push_back({frame.pattern, static_cast<int>(place - exposures_us.begin()),
                        static_cast<double>(frame.edge_timestamp_ns.value_or(0)) / 1e9, true,
                        sampler.take(dn->view())});
    sampling_s += seconds_since(begin);
  }
  const auto begin = steady_clock::now();
  const auto check = check_pictures(manifest->camera, manifest->patterns, pictures);
  std::printf("judged in %.0f ms, sampled in %.2f ms a frame\n", 1000 * seconds_since(begin),
              1000 * sampling_s / static_cast<double>(pictures.size()));
  print_check(check);
  print_swaps(manifest->camera, manifest->patterns, pictures, shares_frac);
  return check.wrong.empty() ? 0 : 1;
}

struct SimulateOptions {
  bench::SceneFramesOptions scene;
  std::string effects_file;
  int capture_count = 100;
  double blink_ms = 0;
  std::vector<double> shares_frac;
};

// nullopt: complained.
std::optional<hw_sim::Effects> effects_of(const bench::Program& program,
                                          const SimulateOptions& options) {
  hw_sim::Effects effects;
  if (!options.effects_file.empty()) {
    const auto read = hw_sim::read_effects(options.effects_file);
    if (!read) {
      program.complain(read.error().detail);
      return std::nullopt;
    }
    effects = *read;
  }
  if (options.blink_ms > 0) {
    effects.blink_s = options.blink_ms / 1000;
    effects.blink_start_s = 0.05;
    effects.blink_period_s = 4.3;  // no part of the capture is left out
  }
  return effects;
}

int check_simulated(const SimulateOptions& options) {
  const bench::Program program{"picture-checks"};
  const auto effects = effects_of(program, options);
  if (!effects) return 1;
  const auto scene =
      bench::SceneFrames::open(program, options.scene, [&](double) { return *effects; });
  if (!scene) return 1;
  const estimation::PictureSampler sampler(scene->camera());
  int alarmed_count = 0;
  std::size_t unchecked_count = 0;
  double judging_s = 0;
  for (int i = 0; i < options.capture_count; ++i) {
    std::vector<estimation::SeenPicture> pictures;
    scene->capture(i, [&](const bench::SceneFrame& frame, const auto& frame_dn) {
      pictures.push_back(
          {frame.pattern, frame.bracket, frame.elapsed_s, true, sampler.take(frame_dn)});
    });
    const auto begin = steady_clock::now();
    const auto check = check_pictures(scene->camera(), scene->plan().patterns, pictures);
    judging_s += seconds_since(begin);
    unchecked_count += check.unchecked.size();
    if (i == 0) print_check(check);
    if (!check.wrong.empty()) {
      ++alarmed_count;
      std::printf("capture %d: alarm: %s\n", i, check.text().c_str());
    }
    if (i == 0) print_swaps(scene->camera(), scene->plan().patterns, pictures, options.shares_frac);
    std::fflush(stdout);
  }
  std::printf(
      "%d captures, %d with a false alarm; %.1f frames a capture unchecked; judged in "
      "%.0f ms each\n",
      options.capture_count, alarmed_count,
      static_cast<double>(unchecked_count) / options.capture_count,
      1000 * judging_s / options.capture_count);
  return alarmed_count == 0 ? 0 : 1;
}

}  // namespace

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own options' names
int main(int argc, char** argv) {
  CLI::App program("frames that do not show their pattern, and false alarms");
  program.require_subcommand(1);
  std::string session;
  std::vector<double> shares_frac;
  CLI::App* const stored = program.add_subcommand("session", "slots of a stored session swapped");
  stored->add_option("session", session)->required();
  stored->add_option("--share", shares_frac, "of the picture before, 1: all of it");
  SimulateOptions options;
  CLI::App* const simulate = program.add_subcommand("simulate", "false alarms over a face");
  simulate->add_option("rig", options.scene.rig_file, "a rig file of the virtual rig")->required();
  simulate->add_option("--captures", options.capture_count)->capture_default_str();
  simulate->add_option("--scene", options.scene.scene)->capture_default_str();
  simulate->add_option("--effects", options.effects_file, "config/effects.example.toml");
  simulate->add_option("--cycle-ms", options.scene.cycle_ms, "from pattern to pattern")
      ->capture_default_str();
  simulate->add_option("--blink-ms", options.blink_ms, "0: none")->capture_default_str();
  simulate->add_flag("--in-order", options.scene.is_in_order, "stripes by their shift");
  simulate->add_option("--seed", options.scene.seed)->capture_default_str();
  simulate->add_option("--share", options.shares_frac, "swaps in the first capture");
  CLI11_PARSE(program, argc, argv);
  if (stored->parsed()) return check_session(session, shares_frac);
  return check_simulated(options);
}
