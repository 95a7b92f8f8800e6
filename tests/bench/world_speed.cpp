// world-speed: what the virtual rig costs, from an empty cache to a captured session.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "estimation/session/maps.h"
#include "tests/bench/world_capture.h"
#include "tests/capture/ledger_rig.h"
#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;

const bench::Program kProgram{"world-speed"};

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
      kProgram.complain(effects.error().detail);
      return nullptr;
    }
    scene.effects = *effects;
  }
  Stages stages;
  auto world =
      hw_sim::HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene,
                                [&](double, const std::string& what) { stages.enter(what); });
  if (!world) kProgram.complain(world.error().detail);
  return world ? std::move(*world) : nullptr;
}

// Frames alone: the estimator has its own benchmarks.
bool capture(const hw_sim::HeadWorld& world, const rig::RigFile& rig_file, const fs::path& folder) {
  capture::CaptureOptions options;
  options.directory = folder;
  options.product = capture::CaptureProduct::kFramesAlone;
  const Stopwatch watch;
  const auto finished = bench::capture_in_process(kProgram, world, rig_file, options);
  row("capture of 88 x 2 frames, in process, written", watch);
  if (!finished) return false;
  const bool is_done = finished->result.exit_code == capture::ExitCode::kDone;
  if (!is_done) kProgram.complain(finished->result.message);
  return is_done;
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
  const auto rig_file = bench::rig_file_of(kProgram, options.rig_file);
  if (!rig_file) return 2;
  const auto rig = bench::rig_of(kProgram, *rig_file);
  if (!rig) return 2;
  const test_support::TemporaryFolder folder;
  const fs::path& scratch = folder.path();
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
