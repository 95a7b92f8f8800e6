// world-effects: what each effect of the virtual rig, alone, does to a capture's maps: how much of
// the face stays valid, which verdict took the rest, and how far off the valid part is.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <variant>
#include <vector>

#include "estimation/session/maps.h"
#include "hw_sim/world/judge.h"
#include "tests/bench/world_capture.h"
#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;
using hw_sim::Effects;

const bench::Program kProgram{"world-effects"};

using Member =
    std::variant<double Effects::*, int Effects::*, bool Effects::*, estimation::Vec3 Effects::*>;

struct Case {
  enum class From { kNothing, kEverything };
  std::string name;
  From from = From::kNothing;
  std::vector<Member> members = {};  // taken from the example, or left out of it
  double drift_x_mm_per_s = 0, drift_z_mm_per_s = 0;
};

// Groups of the example's effects, each alone; subjects that move at a few speeds.
std::vector<Case> cases() {
  using E = Effects;
  using From = Case::From;
  return {
      {.name = "none"},
      {.name = "projector's blur, defocus, fill",
       .members = {&E::blur_px, &E::focus_mm, &E::defocus_px_per_mm, &E::pixel_fill_frac}},
      {.name = "its gamma", .members = {&E::gamma}},
      {.name = "its black and vignetting", .members = {&E::black_frac, &E::vignetting_frac}},
      {.name = "crosstalk", .members = {&E::crosstalk_frac}},
      {.name = "lag, scan-out, ripple",
       .members = {&E::input_lag_refreshes, &E::scanout_ms, &E::ripple_frac, &E::ripple_hz}},
      {.name = "camera's blur and defocus",
       .members = {&E::camera_blur_px, &E::camera_focus_mm, &E::camera_defocus_px_per_mm}},
      {.name = "its vignetting", .members = {&E::camera_vignetting_frac}},
      {.name = "its full well", .members = {&E::full_well_e}},
      {.name = "its fixed pattern", .members = {&E::pixel_gain_sd_frac, &E::pixel_offset_sd_dn}},
      {.name = "its hot pixels", .members = {&E::hot_pixel_frac, &E::hot_pixel_dn_per_s}},
      {.name = "room and wall",
       .members = {&E::ambient_frac, &E::flicker_frac, &E::mains_hz, &E::backdrop_reflectance_frac,
                   &E::backdrop_mm}},
      {.name = "away at 0.01 mm/s", .drift_z_mm_per_s = 0.01},
      {.name = "away at 0.05 mm/s", .drift_z_mm_per_s = 0.05},
      {.name = "away at 0.2 mm/s", .drift_z_mm_per_s = 0.2},
      // What 0.2 mm/s is to a capture five times as slow.
      {.name = "away at 1 mm/s", .drift_z_mm_per_s = 1},
      {.name = "away at 2 mm/s", .drift_z_mm_per_s = 2},
      {.name = "sideways at 0.2 mm/s", .drift_x_mm_per_s = 0.2},
      {.name = "breathing", .members = {&E::breathing_mm, &E::breathing_hz}},
      {.name = "all but motion",
       .from = From::kEverything,
       .members = {&E::drift_mm_per_s, &E::breathing_mm, &E::blink_s}},
      {.name = "all", .from = From::kEverything},
  };
}

Effects effects_of(const Case& one, const Effects& example) {
  const bool is_all = one.from == Case::From::kEverything;
  const Effects none;
  Effects own = is_all ? example : none;
  for (const Member& member : one.members)
    std::visit([&](auto which) { own.*which = (is_all ? none : example).*which; }, member);
  own.drift_mm_per_s += estimation::Vec3(one.drift_x_mm_per_s, 0, one.drift_z_mm_per_s);
  return own;
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

bool show(const Case& each, const Effects& example, const rig::RigFile& rig_file,
          const hw_sim::SimulatedRig& rig, const Options& options, const fs::path& scratch) {
  hw_sim::SceneOptions scene;
  scene.scattering = hw_sim::ScatteringModel::kMonteCarlo;
  scene.cache_folder = options.cache;
  scene.thread_count = options.threads;
  scene.effects = effects_of(each, example);
  const auto world = hw_sim::HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene);
  if (!world || !(*world)->write_truth(scratch / "truth")) return false;
  capture::CaptureOptions capture_options;
  capture_options.directory = scratch / "sessions";
  capture_options.estimator.thread_count = options.threads;
  capture_options.estimator.model = options.model;
  const auto finished = bench::capture_in_process(kProgram, **world, rig_file, capture_options);
  if (!finished) return false;
  const auto& [result, lasted_s] = *finished;
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
  auto rig_file = bench::rig_file_of(kProgram, options.rig_file);
  const auto example = hw_sim::read_effects(options.effects_file);
  if (!example) kProgram.complain(example.error().detail);
  if (!rig_file || !example) return 2;
  // A cheek, half the nose and the mouth: as good as the face, in a tenth of the time.
  if (!options.is_whole) {
    rig_file->camera.width_px = 160;
    rig_file->camera.height_px = 120;
    rig_file->camera.offset_x_px = 200;
    rig_file->camera.offset_y_px = 256;
  }
  const auto rig = bench::rig_of(kProgram, *rig_file);
  if (!rig) return 2;
  std::printf(
      "| effect | lasted s | valid %% | of it, poor fit | not identifiable | outside model | other "
      "| sigma_a off %% | sigma_s' | l_d | R_d | position mm | motion "
      "|\n|---|---|---|---|---|---|---|"
      "---|---|---|---|---|---|\n");
  bool is_done = true;
  for (const Case& each : cases()) {
    if (!options.only.empty() &&
        std::find(options.only.begin(), options.only.end(), each.name) == options.only.end())
      continue;
    const test_support::TemporaryFolder scratch;
    is_done = show(each, *example, *rig_file, *rig, options, scratch.path()) && is_done;
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
  app.add_option("--only", options.only, "Rows by name; may be given again");
  app.add_option("--model", options.model, "How the estimator has light scatter")
      ->capture_default_str();
  app.add_flag("--whole", options.is_whole, "All of the sensor, with the judge's tables");
  app.add_option("--threads", options.threads, "Threads to use")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  return run(options);
}
