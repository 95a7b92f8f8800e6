// world-effects: what each effect of the virtual rig, alone, does to a capture's maps: how much of
// the face stays valid, which verdict took the rest, and how far off the valid part is.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "capture/capture_job.h"
#include "estimation/session/maps.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/judge.h"
#include "hw_sim/world/simulated_rig.h"

namespace {

namespace fs = std::filesystem;
using hw_sim::Effects;

struct Case {
  std::string name;
  std::function<void(const Effects& all, Effects& own)> choose;
};

// Groups of the example's effects, each alone; subjects that move at a few speeds.
std::vector<Case> cases() {
  const auto drift = [](double x_mm_per_s, double z_mm_per_s) {
    return [=](const Effects&, Effects& own) { own.drift_mm_per_s = {x_mm_per_s, 0, z_mm_per_s}; };
  };
  return {
      {"none", [](const Effects&, Effects&) {}},
      {"projector's blur, defocus, fill",
       [](const Effects& all, Effects& own) {
         own.blur_px = all.blur_px;
         own.focus_mm = all.focus_mm;
         own.defocus_px_per_mm = all.defocus_px_per_mm;
         own.pixel_fill_frac = all.pixel_fill_frac;
       }},
      {"its black and vignetting",
       [](const Effects& all, Effects& own) {
         own.black_frac = all.black_frac;
         own.vignetting_frac = all.vignetting_frac;
       }},
      {"crosstalk",
       [](const Effects& all, Effects& own) { own.crosstalk_frac = all.crosstalk_frac; }},
      {"lag, scan-out, ripple",
       [](const Effects& all, Effects& own) {
         own.input_lag_refreshes = all.input_lag_refreshes;
         own.scanout_ms = all.scanout_ms;
         own.ripple_frac = all.ripple_frac;
       }},
      {"camera's blur and defocus",
       [](const Effects& all, Effects& own) {
         own.camera_blur_px = all.camera_blur_px;
         own.camera_defocus_px_per_mm = all.camera_defocus_px_per_mm;
       }},
      {"its vignetting, full well, pixels",
       [](const Effects& all, Effects& own) {
         own.camera_vignetting_frac = all.camera_vignetting_frac;
         own.full_well_e = all.full_well_e;
         own.pixel_gain_sd_frac = all.pixel_gain_sd_frac;
         own.pixel_offset_sd_dn = all.pixel_offset_sd_dn;
         own.hot_pixel_frac = all.hot_pixel_frac;
         own.hot_pixel_dn_per_s = all.hot_pixel_dn_per_s;
       }},
      {"room and wall",
       [](const Effects& all, Effects& own) {
         own.ambient_frac = all.ambient_frac;
         own.flicker_frac = all.flicker_frac;
         own.backdrop_reflectance_frac = all.backdrop_reflectance_frac;
         own.backdrop_mm = all.backdrop_mm;
       }},
      {"away at 0.01 mm/s", drift(0, 0.01)},
      {"away at 0.05 mm/s", drift(0, 0.05)},
      {"away at 0.2 mm/s", drift(0, 0.2)},
      {"away at 1 mm/s", drift(0, 1)},  // what 0.2 mm/s is to a capture five times as slow
      {"away at 2 mm/s", drift(0, 2)},
      {"sideways at 0.2 mm/s", drift(0.2, 0)},
      {"breathing",
       [](const Effects& all, Effects& own) {
         own.breathing_mm = all.breathing_mm;
         own.breathing_hz = all.breathing_hz;
       }},
      {"all but motion",
       [](const Effects& all, Effects& own) {
         own = all;
         own.drift_mm_per_s = own.breathing_mm = {0, 0, 0};
         own.blink_s = 0;
       }},
      {"all", [](const Effects& all, Effects& own) { own = all; }},
  };
}

struct Options {
  fs::path rig_file, effects_file, cache = hw_sim::default_cache_folder();
  std::vector<std::string> only;
  std::string model = "monte_carlo_angular";
  bool is_whole = false;
  int threads = 2;
};

std::string fraction(std::size_t count, std::size_t total) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f",
                total == 0 ? 0.0 : 100 * static_cast<double>(count) / static_cast<double>(total));
  return text;
}

// Of the red band's pixels that see the subject: which verdict.
std::string verdicts(const fs::path& maps_folder) {
  const auto maps = estimation::read_maps(maps_folder);
  if (!maps) return maps.error().text();
  std::size_t seen = 0, valid = 0, poor = 0, unknown = 0, model = 0, other = 0;
  for (const std::uint32_t bits : maps->validity[0].samples()) {
    if ((bits & estimation::kBackground) != 0) continue;
    ++seen;
    const std::uint32_t errors = bits & estimation::kValidityErrors;
    if (errors == 0) ++valid;
    if (errors == 0 && (bits & estimation::kPoorFit) != 0) ++poor;
    if ((errors & estimation::kNotIdentifiable) != 0)
      ++unknown;
    else if ((errors & estimation::kOutsideModel) != 0)
      ++model;
    else if (errors != 0)
      ++other;
  }
  return fraction(valid, seen) + " | " + fraction(poor, seen) + " | " + fraction(unknown, seen) +
         " | " + fraction(model, seen) + " | " + fraction(other, seen);
}

bool show(const Case& each, const Effects& effects, const rig::RigFile& rig_file,
          const hw_sim::SimulatedRig& rig, const Options& options, const fs::path& scratch) {
  hw_sim::SceneOptions scene;
  scene.scattering = hw_sim::ScatteringModel::kMonteCarlo;
  scene.cache_folder = options.cache;
  scene.thread_count = options.threads;
  each.choose(effects, scene.effects);
  const auto world = hw_sim::HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene);
  if (!world || !(*world)->write_truth(scratch / "truth")) return false;
  capture::CaptureOptions capture_options;
  capture_options.directory = scratch / "sessions";
  capture_options.created =
      std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  capture_options.estimator.thread_count = options.threads;
  capture_options.estimator.model = options.model;
  const auto job = capture::CaptureJob::prepare(rig_file, capture_options);
  if (!job) {
    std::fprintf(stderr, "world-effects: %s\n", job.error().message.c_str());
    return false;
  }
  hw_sim::InProcessRig devices(**world,
                               {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
  const auto begin = devices.timeline().now();
  const capture::CaptureResult result = job->run(
      {devices.projector(), devices.trigger(), devices.camera(), devices.timeline()}, {}, {});
  const double lasted_s = std::chrono::duration<double>(devices.timeline().now() - begin).count();
  const auto judged = hw_sim::judge(result.session / "maps", scratch / "truth");
  if (!judged) {
    std::printf("| %s | %.0f | - | %s %s |\n", each.name.c_str(), lasted_s, result.message.c_str(),
                judged.error().text().c_str());
    return true;
  }
  const hw_sim::BandErrors& red = judged->face.bands[0];
  std::printf("| %s | %.0f | %s | %.2f | %.2f | %.2f | %.2f | %.3f | %s |\n", each.name.c_str(),
              lasted_s, verdicts(result.session / "maps").c_str(), 100 * red.sigma_a.median,
              100 * red.sigma_s_prime.median, 100 * red.translucency.median,
              100 * red.diffuse_reflectance.median, judged->face.position_mm.median,
              result.motion.c_str());
  if (options.is_whole) std::printf("\n%s\n", judged->table().c_str());
  std::fflush(stdout);
  return true;
}

int run(const Options& options) {
  auto rig_file = rig::read_rig_file(options.rig_file);
  const auto effects = hw_sim::read_effects(options.effects_file);
  if (!rig_file || !effects) {
    std::fprintf(stderr, "world-effects: %s\n",
                 (!rig_file ? rig_file.error() : effects.error()).detail.c_str());
    return 2;
  }
  // A cheek, half the nose and the mouth: as good as the face, in a tenth of the time.
  if (!options.is_whole) {
    rig_file->camera.width_px = 160;
    rig_file->camera.height_px = 120;
    rig_file->camera.offset_x_px = 200;
    rig_file->camera.offset_y_px = 256;
  }
  const auto rig = hw_sim::simulated_rig(*rig_file);
  if (!rig) {
    std::fprintf(stderr, "world-effects: %s\n", rig.error().detail.c_str());
    return 2;
  }
  std::printf(
      "| effect | lasted s | valid %% | of it, poor fit | not identifiable | outside model | other "
      "| sigma_a off %% | sigma_s' | l_d | R_d | position mm | motion "
      "|\n|---|---|---|---|---|---|---|"
      "---|---|---|---|---|---|\n");
  bool is_done = true;
  const fs::path scratch =
      fs::temp_directory_path() / ("world-effects-" + std::to_string(::getpid()));
  for (const Case& each : cases()) {
    if (!options.only.empty() &&
        std::find(options.only.begin(), options.only.end(), each.name) == options.only.end())
      continue;
    is_done = show(each, *effects, *rig_file, *rig, options, scratch) && is_done;
    std::error_code ignored;
    fs::remove_all(scratch, ignored);
  }
  return is_done ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("What each effect of the virtual rig does to a capture's maps");
  Options options;
  app.add_option("--rig", options.rig_file, "Rig file of the rig to simulate")->required();
  app.add_option("--effects", options.effects_file, "TOML file of effects to take apart")
      ->required();
  app.add_option("--cache", options.cache, "Folder of computed light transport");
  app.add_option("--only", options.only, "Rows by name; comma-separated")->delimiter(',');
  app.add_option("--model", options.model, "How the estimator has light scatter")
      ->capture_default_str();
  app.add_flag("--whole", options.is_whole, "All of the sensor, with the judge's tables");
  app.add_option("--threads", options.threads, "Threads to use")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  return run(options);
}
