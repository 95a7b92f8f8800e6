// How often the watch on brief changes of light cries wolf over a face that holds still, and how
// many blinks of a few patterns' length it finds: many captures' frames straight from the simulated
// face, without devices or files.
//   blink-alarms RIG [--captures N] [--cycle-ms T] [--blink-ms T] [--breathing] [--seed N]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "estimation/motion/brief_change.h"
#include "estimation/motion/motion_scale.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"
#include "rig/rig_file.h"

namespace {

using std::chrono::duration_cast;
using std::chrono::nanoseconds;

struct Options {
  std::string rig_file;
  int capture_count = 100;
  double cycle_ms = 66.7;
  double blink_ms = 0;
  bool is_breathing = false;
  std::uint64_t seed = 1;
};

nanoseconds ms(double time_ms) {
  return duration_cast<nanoseconds>(std::chrono::duration<double, std::milli>(time_ms));
}

// Captures one after the other, a second apart; each has its blink somewhere else.
hw_sim::Effects effects_of(const Options& options, double capture_s) {
  hw_sim::Effects effects;
  if (options.is_breathing) {
    effects.breathing_mm = {0, 0.2, 0.4};
    effects.ambient_frac = 0.01;
    effects.flicker_frac = 0.3;
  }
  if (options.blink_ms > 0) {
    constexpr double kGoldenRatio = 1.6180339887;  // no part of the capture is left out
    effects.blink_s = options.blink_ms / 1000;
    effects.blink_start_s = 0.05;
    effects.blink_period_s = (capture_s + 1) * kGoldenRatio / 2;
  }
  return effects;
}

struct Tally {
  int frames = 0, alarms = 0, alarmed_captures = 0;
  int blinks = 0, found = 0, blink_patterns = 0, named = 0;
  double judging_s = 0;
};

class Bench {
 public:
  static std::unique_ptr<Bench> open(const Options& options) {
    const auto file = rig::read_rig_file(options.rig_file);
    if (!file) return complain(file.error());
    const auto rig = hw_sim::simulated_rig(*file);
    if (!rig) return complain(rig.error());
    auto plan = capture::make_plan("paper", file->projector, file->sequence);
    if (!plan) return complain(plan.error());
    const double capture_s = options.cycle_ms / 1000 * static_cast<double>(plan->order.size());
    const hw_sim::Effects effects = effects_of(options, capture_s);
    auto world = hw_sim::HeadWorld::create(rig->camera, rig->projector, rig->calibration,
                                           {.name = "face_female",
                                            .effects = effects,
                                            .has_indirect = false,
                                            .has_identity = false,
                                            .seed = options.seed,
                                            .thread_count = 2,
                                            .cache_folder = hw_sim::default_cache_folder()});
    if (!world) return complain(world.error());
    return std::unique_ptr<Bench>(
        new Bench(options, *file, *rig, std::move(*plan), effects, std::move(*world), capture_s));
  }

  Tally run() {
    Tally tally;
    for (int i = 0; i < options_.capture_count; ++i) capture(i, tally);
    return tally;
  }

 private:
  static std::unique_ptr<Bench> complain(const rig::Error& error) {
    std::fprintf(stderr, "blink-alarms: %s\n", error.detail.c_str());
    return nullptr;
  }

  Bench(const Options& options, const rig::RigFile& file, const hw_sim::SimulatedRig& rig,
        capture::Plan plan, const hw_sim::Effects& effects,
        std::unique_ptr<hw_sim::HeadWorld> world, double capture_s)
      : options_(options),
        camera_(rig.camera),
        plan_(std::move(plan)),
        effects_(effects),
        world_(std::move(world)),
        capture_s_(capture_s) {
    const auto scale =
        estimation::motion_scale(rig.camera, rig.calibration, estimation::Axis::kColumn);
    grid_ = estimation::block_grid(camera_, estimation::Axis::kColumn,
                                   estimation::Stripes{}.period_px / scale.projector_px_per_px);
    std::uint64_t id = 1;
    for (auto& picture : capture::render_pictures(plan_, file.projector))
      pictures_.push_back(
          std::make_shared<const hw_sim::Picture>(hw_sim::Picture{id++, std::move(picture)}));
  }

  void capture(int number, Tally& tally) {
    const double start_s = number * (capture_s_ + 1);
    std::vector<estimation::SeenFrame> frames;
    std::vector<double> open_frac(pictures_.size());  // [pattern] of its frames, the most
    for (std::size_t place = 0; place < plan_.order.size(); ++place) {
      const int pattern = plan_.order[place];
      double at_s = start_s + static_cast<double>(place) * options_.cycle_ms / 1000;
      for (std::size_t bracket = 0; bracket < plan_.exposures.size(); ++bracket) {
        const double exposure_s = std::chrono::duration<double>(plan_.exposures[bracket]).count();
        frames.push_back(expose(pattern, static_cast<int>(bracket), at_s, at_s - start_s));
        double& open = open_frac[static_cast<std::size_t>(pattern)];
        open = std::max(open, effects_.blink_frac(at_s, at_s + exposure_s));
        constexpr double kGap_s = 0.002;
        at_s += exposure_s + kGap_s;
      }
    }
    const auto began = std::chrono::steady_clock::now();
    const auto found = find_brief_changes(camera_, grid_, plan_.patterns, frames);
    tally.judging_s +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    judge(found, open_frac, tally);
    tally.frames += static_cast<int>(frames.size());
  }

  estimation::SeenFrame expose(int pattern, int bracket, double at_s, double elapsed_s) {
    const auto duration = plan_.exposures[static_cast<std::size_t>(bracket)];
    const auto& picture = pictures_[static_cast<std::size_t>(pattern)];
    estimation::Image<std::uint16_t> frame(camera_.height_px, camera_.width_px);
    world_->expose({.light = {{picture, duration}},
                    .duration = duration,
                    .start = ms(1000 * at_s),
                    .trigger_number = ++trigger_number_},
                   frame.view());
    return {pattern, bracket, elapsed_s, block_light(camera_, grid_, std::as_const(frame).view())};
  }

  // A blink that is open for half an exposure is one; less may be found.
  static void judge(const std::vector<estimation::BriefChange>& found,
                    const std::vector<double>& open_frac, Tally& tally) {
    const auto open = [&](int pattern) { return open_frac[static_cast<std::size_t>(pattern)]; };
    bool is_alarmed = false, is_found = false;
    for (const estimation::BriefChange& change : found) {
      double most = 0;
      for (const int pattern : change.patterns) most = std::max(most, open(pattern));
      if (most > 0) {
        is_found = true;
        for (const int pattern : change.patterns) tally.named += open(pattern) >= 0.5 ? 1 : 0;
        continue;
      }
      is_alarmed = true;
      ++tally.alarms;
      std::printf("alarm: %.1f%% around row %.0f, column %.0f, pattern %d and %zu more%s\n",
                  100 * change.change_frac, change.row_px, change.col_px, change.patterns.front(),
                  change.patterns.size() - 1, change.is_everywhere ? ", everywhere" : "");
    }
    tally.alarmed_captures += is_alarmed ? 1 : 0;
    const auto open_count =
        std::count_if(open_frac.begin(), open_frac.end(), [](double frac) { return frac >= 0.5; });
    tally.blink_patterns += static_cast<int>(open_count);
    if (open_count == 0) return;
    ++tally.blinks;
    tally.found += is_found ? 1 : 0;
  }

  const Options options_;
  const estimation::CameraInfo camera_;
  const capture::Plan plan_;
  const hw_sim::Effects effects_;
  const std::unique_ptr<hw_sim::HeadWorld> world_;
  const double capture_s_;
  estimation::BlockGrid grid_;
  std::vector<std::shared_ptr<const hw_sim::Picture>> pictures_;
  std::uint64_t trigger_number_ = 0;
};

}  // namespace

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own options' names
int main(int argc, char** argv) {
  Options options;
  CLI::App program("false alarms and blinks found by the watch on brief changes of light");
  program.add_option("rig", options.rig_file, "a rig file of the virtual rig")->required();
  program.add_option("--captures", options.capture_count)->capture_default_str();
  program.add_option("--cycle-ms", options.cycle_ms, "from pattern to pattern")
      ->capture_default_str();
  program.add_option("--blink-ms", options.blink_ms, "0: none")->capture_default_str();
  program.add_flag("--breathing", options.is_breathing, "and a lamp that flickers");
  program.add_option("--seed", options.seed)->capture_default_str();
  CLI11_PARSE(program, argc, argv);
  const auto bench = Bench::open(options);
  if (!bench) return 1;
  const Tally tally = bench->run();
  std::printf(
      "%d captures, %d frames: %d with a false alarm; of %d blinks %d found, of %d patterns "
      "%d named; judged in %.0f ms each\n",
      options.capture_count, tally.frames, tally.alarmed_captures, tally.blinks, tally.found,
      tally.blink_patterns, tally.named, 1000 * tally.judging_s / options.capture_count);
  return 0;
}
