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
#include <utility>
#include <vector>

#include "estimation/motion/brief_change.h"
#include "estimation/motion/motion_scale.h"
#include "tests/bench/scene_frames.h"

namespace {

struct Options {
  bench::SceneFramesOptions scene;
  int capture_count = 100;
  double blink_ms = 0;
  bool is_breathing = false;
};

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
  Bench(int capture_count, std::unique_ptr<bench::SceneFrames> scene)
      : capture_count_(capture_count), scene_(std::move(scene)) {
    const auto scale = estimation::motion_scale(scene_->camera(), scene_->calibration(),
                                                estimation::Axis::kColumn);
    grid_ = estimation::block_grid(scene_->camera(), estimation::Axis::kColumn,
                                   estimation::Stripes{}.period_px / scale.projector_px_per_px);
  }

  Tally run() {
    Tally tally;
    for (int i = 0; i < capture_count_; ++i) capture(i, tally);
    return tally;
  }

 private:
  void capture(int number, Tally& tally) {
    std::vector<estimation::SeenFrame> frames;
    std::vector<double> open_frac(scene_->plan().patterns.size());  // of its frames, the most
    scene_->capture(number, [&](const bench::SceneFrame& frame, const auto& frame_dn) {
      frames.push_back({frame.pattern, frame.bracket, frame.elapsed_s,
                        block_light(scene_->camera(), grid_, frame_dn)});
      double& open = open_frac[static_cast<std::size_t>(frame.pattern)];
      open =
          std::max(open, scene_->effects().blink_frac(frame.at_s, frame.at_s + frame.exposure_s));
    });
    const auto began = std::chrono::steady_clock::now();
    const auto found = find_brief_changes(scene_->camera(), grid_, scene_->plan().patterns, frames);
    tally.judging_s +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    judge(found, open_frac, tally);
    tally.frames += static_cast<int>(frames.size());
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

  const int capture_count_;
  const std::unique_ptr<bench::SceneFrames> scene_;
  estimation::BlockGrid grid_;
};

}  // namespace

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own options' names
int main(int argc, char** argv) {
  Options options;
  CLI::App program("false alarms and blinks found by the watch on brief changes of light");
  program.add_option("rig", options.scene.rig_file, "a rig file of the virtual rig")->required();
  program.add_option("--captures", options.capture_count)->capture_default_str();
  program.add_option("--cycle-ms", options.scene.cycle_ms, "from pattern to pattern")
      ->capture_default_str();
  program.add_option("--blink-ms", options.blink_ms, "0: none")->capture_default_str();
  program.add_flag("--breathing", options.is_breathing, "and a lamp that flickers");
  program.add_option("--seed", options.scene.seed)->capture_default_str();
  CLI11_PARSE(program, argc, argv);
  auto scene = bench::SceneFrames::open(
      {"blink-alarms"}, options.scene,
      [&options](double capture_s) { return effects_of(options, capture_s); });
  if (!scene) return 1;
  const Tally tally = Bench(options.capture_count, std::move(scene)).run();
  std::printf(
      "%d captures, %d frames: %d with a false alarm; of %d blinks %d found, of %d patterns "
      "%d named; judged in %.0f ms each\n",
      options.capture_count, tally.frames, tally.alarmed_captures, tally.blinks, tally.found,
      tally.blink_patterns, tally.named, 1000 * tally.judging_s / options.capture_count);
  return 0;
}
