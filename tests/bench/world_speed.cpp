// world-speed: what the virtual rig costs, from an empty cache to a captured session.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "capture/capture_job.h"
#include "estimation/session/maps.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"
#include "tests/capture/ledger_rig.h"

namespace {

namespace fs = std::filesystem;

class Stopwatch {
 public:
  double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }
  // Of all threads: what a loaded machine does not change much.
  double cpu_seconds() const {
    return static_cast<double>(std::clock() - cpu_start_) / CLOCKS_PER_SEC;
  }

 private:
  std::clock_t cpu_start_ = std::clock();
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

struct SpeedOptions {
  fs::path rig_file, cache;
  std::string scene = "face_female";
  fs::path effects_file;
  bool is_cold = false;
  bool has_bounces = false;
  int threads = 2;
};

void row(const std::string& what, const Stopwatch& watch) {
  std::printf("| %s | %.2f | %.2f |\n", what.c_str(), watch.seconds(), watch.cpu_seconds());
  std::fflush(stdout);
}

// How long each stage of making a world takes.
class Stages {
 public:
  void enter(const std::string& name) {
    if (name == name_) return;
    if (!name_.empty()) row("  " + name_, watch_);
    name_ = name;
    watch_ = {};
  }

 private:
  std::string name_;
  Stopwatch watch_;
};

std::unique_ptr<hw_sim::HeadWorld> make_world(const hw_sim::SimulatedRig& rig,
                                              const SpeedOptions& options) {
  hw_sim::SceneOptions scene;
  scene.name = options.scene;
  scene.scattering = hw_sim::ScatteringModel::kMonteCarlo;
  scene.cache_folder = options.cache;
  scene.thread_count = options.threads;
  if (!options.effects_file.empty()) {
    auto effects = hw_sim::read_effects(options.effects_file);
    if (!effects) {
      std::fprintf(stderr, "world-speed: %s\n", effects.error().detail.c_str());
      return nullptr;
    }
    scene.effects = *effects;
  }
  Stages stages;
  auto world =
      hw_sim::HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene,
                                [&](double, const std::string& what) { stages.enter(what); });
  if (!world) std::fprintf(stderr, "world-speed: %s\n", world.error().detail.c_str());
  return world ? std::move(*world) : nullptr;
}

// Frames alone: the estimator has its own benchmarks.
bool capture(const hw_sim::HeadWorld& world, const rig::RigFile& rig_file, const fs::path& folder) {
  capture::CaptureOptions options;
  options.directory = folder;
  options.product = capture::CaptureProduct::kFramesAlone;
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  const auto job = capture::CaptureJob::prepare(rig_file, options);
  if (!job) {
    std::fprintf(stderr, "world-speed: %s\n", job.error().message.c_str());
    return false;
  }
  hw_sim::InProcessRig rig(world,
                           {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
  const Stopwatch watch;
  const capture::CaptureResult result =
      job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
  row("capture of 88 x 2 frames, in process, written", watch);
  if (result.exit_code != capture::ExitCode::kDone)
    std::fprintf(stderr, "world-speed: %s\n", result.message.c_str());
  return result.exit_code == capture::ExitCode::kDone;
}

bool capture_ledger() {
  constexpr int kRepeats = 20;
  const Stopwatch watch;
  for (int i = 0; i < kRepeats; ++i) {
    capture::LedgerCapture ledger;
    if (ledger.run().outcome != capture::Outcome::kComplete) return false;
  }
  row("20 captures of the ledger world, 64 x 48", watch);
  return true;
}

// What each bounce of light between the scene's parts adds to the reflectance factor, of R_d, over
// the places that are lit within 60 degrees.
bool show_bounces(const hw_sim::SimulatedRig& rig, const SpeedOptions& options,
                  const fs::path& scratch) {
  constexpr int kBounces = 4;
  std::printf("\n| bounce | median %% | p95 %% | largest %% |\n|---|---|---|---|\n");
  hw_sim::SceneOptions scene;
  scene.name = options.scene;
  scene.cache_folder = options.cache;
  scene.thread_count = options.threads;
  std::vector<float> before;
  for (scene.bounces = 1; scene.bounces <= kBounces; ++scene.bounces) {
    const auto world = hw_sim::HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene);
    if (!world || !(*world)->write_truth(scratch / "truth")) return false;
    const auto maps = estimation::read_maps(scratch / "truth");
    const auto extra = estimation::read_exr(scratch / "truth" / "scene.exr");
    if (!maps || !extra) return false;
    const auto red = maps->indirect[0].samples(), lit = extra->at("lit").samples(),
               cosine = extra->at("cos_projector").samples();
    before.resize(red.size(), 0.0F);
    std::vector<double> added;
    for (std::size_t i = 0; i < red.size(); ++i) {
      if (!(lit[i] > 0 && cosine[i] > 0.5F)) continue;
      added.push_back(100 * static_cast<double>((red[i] - before[i]) /
                                                maps->diffuse_reflectance[0].samples()[i]));
      before[i] = red[i];
    }
    std::sort(added.begin(), added.end());
    if (added.empty()) return false;
    std::printf("| %d | %.3f | %.3f | %.3f |\n", scene.bounces, added[added.size() / 2],
                added[added.size() * 95 / 100], added.back());
  }
  return true;
}

int run(SpeedOptions options) {
  const auto rig_file = rig::read_rig_file(options.rig_file);
  if (!rig_file) {
    std::fprintf(stderr, "world-speed: %s\n", rig_file.error().detail.c_str());
    return 2;
  }
  const auto rig = hw_sim::simulated_rig(*rig_file);
  if (!rig) {
    std::fprintf(stderr, "world-speed: %s\n", rig.error().detail.c_str());
    return 2;
  }
  const fs::path scratch =
      fs::temp_directory_path() / ("world-speed-" + std::to_string(::getpid()));
  fs::create_directories(scratch);
  if (options.is_cold) options.cache = scratch / "cache";
  std::printf("%d x %d, %s, %d threads\n\n| what | s | s of CPU |\n|---|---|---|\n",
              rig->camera.width_px, rig->camera.height_px, options.scene.c_str(), options.threads);
  bool is_done = true;
  if (options.is_cold) {
    const Stopwatch watch;
    is_done = make_world(*rig, options) != nullptr;
    row("world made from an empty cache", watch);
  }
  if (is_done) {
    const Stopwatch watch;
    const auto world = make_world(*rig, options);
    row("world made from the cache", watch);
    is_done = world && capture(*world, *rig_file, scratch / "sessions");
  }
  is_done = capture_ledger() && is_done;
  if (options.has_bounces) is_done = show_bounces(*rig, options, scratch) && is_done;
  std::error_code ignored;
  fs::remove_all(scratch, ignored);
  return is_done ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("What the virtual rig costs, on this machine");
  SpeedOptions options;
  options.cache = hw_sim::default_cache_folder();
  app.add_option("--rig", options.rig_file, "Rig file of the rig to simulate")->required();
  app.add_option("--scene", options.scene, "Who sits in front of the camera")
      ->capture_default_str();
  app.add_option("--effects", options.effects_file, "TOML file of effects; none by default");
  app.add_flag("--cold", options.is_cold, "Compute everything anew first, in a cache of its own");
  app.add_flag("--bounces", options.has_bounces, "Also what each bounce adds (dipole, red)");
  app.add_option("--threads", options.threads, "Threads to use")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  return run(options);
}
