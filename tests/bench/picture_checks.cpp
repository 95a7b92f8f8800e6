// Whether frames that do not show their pattern are found, and none that does is accused.
//   picture-checks session SESSION            each slot of a stored session made wrong in turn
//   picture-checks simulate RIG [--captures N] [--effects FILE] [--blink-ms T] [--cycle-ms T]
//                                             false alarms over a simulated face
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "estimation/motion/picture_identity.h"
#include "estimation/motion/picture_samples.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world/effects.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"
#include "rig/rig_file.h"
#include "tests/bench/picture_swaps.h"

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
  std::string rig_file, scene = "face_female", effects_file;
  int capture_count = 100;
  double cycle_ms = 66.7, blink_ms = 0;
  bool is_in_order = false;
  std::uint64_t seed = 1;
  std::vector<double> shares_frac;
};

// Captures' frames straight from the simulated face, without devices or files.
class Simulation {
 public:
  static std::unique_ptr<Simulation> open(const SimulateOptions& options) {
    auto file = rig::read_rig_file(options.rig_file);
    if (!file) return complain(file.error());
    if (options.is_in_order) file->sequence.is_shuffled = false;
    const auto rig = hw_sim::simulated_rig(*file);
    if (!rig) return complain(rig.error());
    auto plan = capture::make_plan("paper", file->projector, file->sequence);
    if (!plan) return complain(plan.error());
    hw_sim::Effects effects;
    if (!options.effects_file.empty()) {
      const auto read = hw_sim::read_effects(options.effects_file);
      if (!read) return complain(read.error());
      effects = *read;
    }
    if (options.blink_ms > 0) {
      effects.blink_s = options.blink_ms / 1000;
      effects.blink_start_s = 0.05;
      effects.blink_period_s = 4.3;  // no part of the capture is left out
    }
    auto world = hw_sim::HeadWorld::create(rig->camera, rig->projector, rig->calibration,
                                           {.name = options.scene,
                                            .effects = effects,
                                            .has_indirect = false,
                                            .has_identity = false,
                                            .seed = options.seed,
                                            .thread_count = 2,
                                            .cache_folder = hw_sim::default_cache_folder()});
    if (!world) return complain(world.error());
    return std::unique_ptr<Simulation>(
        new Simulation(options, *file, rig->camera, std::move(*plan), std::move(*world)));
  }

  int run() {
    int alarmed_count = 0;
    std::size_t unchecked_count = 0;
    double judging_s = 0;
    for (int i = 0; i < options_.capture_count; ++i) {
      const auto pictures = capture(i);
      const auto begin = steady_clock::now();
      const auto check = check_pictures(camera_, plan_.patterns, pictures);
      judging_s += seconds_since(begin);
      unchecked_count += check.unchecked.size();
      if (i == 0) print_check(check);
      if (!check.wrong.empty()) {
        ++alarmed_count;
        std::printf("capture %d: alarm: %s\n", i, check.text().c_str());
      }
      if (i == 0) print_swaps(camera_, plan_.patterns, pictures, options_.shares_frac);
      std::fflush(stdout);
    }
    std::printf(
        "%d captures, %d with a false alarm; %.1f frames a capture unchecked; judged in "
        "%.0f ms each\n",
        options_.capture_count, alarmed_count,
        static_cast<double>(unchecked_count) / options_.capture_count,
        1000 * judging_s / options_.capture_count);
    return alarmed_count == 0 ? 0 : 1;
  }

 private:
  static std::unique_ptr<Simulation> complain(const rig::Error& error) {
    std::fprintf(stderr, "picture-checks: %s\n", error.detail.c_str());
    return nullptr;
  }
  Simulation(SimulateOptions options, const rig::RigFile& file,
             const estimation::CameraInfo& camera, capture::Plan plan,
             std::unique_ptr<hw_sim::HeadWorld> world)
      : options_(std::move(options)),
        camera_(camera),
        plan_(std::move(plan)),
        sampler_(camera),
        world_(std::move(world)) {
    std::uint64_t id = 1;
    for (auto& picture : capture::render_pictures(plan_, file.projector))
      pictures_.push_back(
          std::make_shared<const hw_sim::Picture>(hw_sim::Picture{id++, std::move(picture)}));
  }

  std::vector<estimation::SeenPicture> capture(int number) {
    const double capture_s = options_.cycle_ms / 1000 * static_cast<double>(plan_.order.size());
    const double start_s = number * (capture_s + 1);
    std::vector<estimation::SeenPicture> seen;
    for (std::size_t place = 0; place < plan_.order.size(); ++place) {
      const int pattern = plan_.order[place];
      double at_s = start_s + static_cast<double>(place) * options_.cycle_ms / 1000;
      for (std::size_t bracket = 0; bracket < plan_.exposures.size(); ++bracket) {
        seen.push_back({pattern, static_cast<int>(bracket), at_s - start_s, true,
                        expose(pattern, bracket, at_s)});
        constexpr double kGap_s = 0.002;
        at_s += std::chrono::duration<double>(plan_.exposures[bracket]).count() + kGap_s;
      }
    }
    return seen;
  }

  std::vector<std::uint16_t> expose(int pattern, std::size_t bracket, double at_s) {
    const auto duration = plan_.exposures[bracket];
    const auto& picture = pictures_[static_cast<std::size_t>(pattern)];
    estimation::Image<std::uint16_t> frame(camera_.height_px, camera_.width_px);
    const auto start =
        std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(at_s));
    world_->expose({.light = {{picture, duration}},
                    .duration = duration,
                    .start = start,
                    .trigger_number = ++trigger_number_},
                   frame.view());
    return sampler_.take(std::as_const(frame).view());
  }

  const SimulateOptions options_;
  const estimation::CameraInfo camera_;
  const capture::Plan plan_;
  const estimation::PictureSampler sampler_;
  const std::unique_ptr<hw_sim::HeadWorld> world_;
  std::vector<std::shared_ptr<const hw_sim::Picture>> pictures_;
  std::uint64_t trigger_number_ = 0;
};

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
  simulate->add_option("rig", options.rig_file, "a rig file of the virtual rig")->required();
  simulate->add_option("--captures", options.capture_count)->capture_default_str();
  simulate->add_option("--scene", options.scene)->capture_default_str();
  simulate->add_option("--effects", options.effects_file, "config/effects.example.toml");
  simulate->add_option("--cycle-ms", options.cycle_ms, "from pattern to pattern")
      ->capture_default_str();
  simulate->add_option("--blink-ms", options.blink_ms, "0: none")->capture_default_str();
  simulate->add_flag("--in-order", options.is_in_order, "stripes by their shift");
  simulate->add_option("--seed", options.seed)->capture_default_str();
  simulate->add_option("--share", options.shares_frac, "swaps in the first capture");
  CLI11_PARSE(program, argc, argv);
  if (stored->parsed()) return check_session(session, shares_frac);
  const auto simulation = Simulation::open(options);
  return simulation ? simulation->run() : 1;
}
