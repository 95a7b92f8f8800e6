// ssrig-sim picture: scenes as a person would see them under the projector's light.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <system_error>
#include <utility>

#include "estimation/session/pattern.h"
#include "hw_sim/app/commands.h"
#include "hw_sim/app/show_progress.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"

namespace hw_sim {
namespace {

using estimation::Image;

int complain(const std::string& text) {
  std::fprintf(stderr, "ssrig-sim: %s\n", text.c_str());
  return kExitUsage;
}

unsigned char srgb(double linear) {
  const double l = std::clamp(linear, 0.0, 1.0);
  const double v = l <= 0.0031308 ? 12.92 * l : 1.055 * std::pow(l, 1 / 2.4) - 0.055;
  return static_cast<unsigned char>(std::lround(255 * v));
}

// Relative to a white surface at the reference distance, `gain` times brighter. False if it could
// not be written.
bool write_picture(const std::filesystem::path& file, const Image<float>& linear,
                   const std::vector<double>& signal_per_us, double gain) {
  cv::Mat3b pixels(linear.height_px(), linear.width_px());
  for (int row = 0; row < linear.height_px(); ++row)
    for (int col = 0; col < linear.width_px(); ++col)
      for (int band = 0; band < 3; ++band)
        pixels(row, col)[2 - band] = srgb(gain * static_cast<double>(linear.at(row, col, band)) /
                                          signal_per_us[static_cast<std::size_t>(band)]);
  try {
    return cv::imwrite(file.string(), pixels);
  } catch (const cv::Exception&) {
    return false;
  }
}

int write_scene(const std::string& name, const PictureOptions& options, const SimulatedRig& rig) {
  SceneOptions scene;
  scene.name = name;
  scene.scattering = options.is_dipole ? ScatteringModel::kDipole : ScatteringModel::kMonteCarlo;
  scene.cache_folder = default_cache_folder();
  if (!options.effects_file.empty()) {
    const rig::Result<Effects> effects = read_effects(options.effects_file);
    if (!effects) return complain(effects.error().detail);
    scene.effects = *effects;
  }
  const auto world =
      HeadWorld::create(rig.camera, rig.projector, rig.calibration, scene, show_progress);
  if (!world) return complain(world.error().detail);
  const std::pair<const char*, estimation::PatternKind> patterns[] = {
      {"white", estimation::White{}},
      {"stripes", estimation::Stripes{estimation::Axis::kColumn, 40, 8, 0}}};
  // Skin under white at half of full scale, and its stripes as bright again as they look.
  for (const auto& [light, kind] : patterns) {
    const Picture picture{
        1, estimation::render_pattern(kind, rig.projector.height_px, rig.projector.width_px)};
    const std::filesystem::path file = options.out / (name + "-" + light + ".png");
    if (!write_picture(file, (*world)->linear_image(picture),
                       rig.calibration.irradiance->signal_per_us, 1.2)) {
      std::fprintf(stderr, "ssrig-sim: cannot write %s; make room there\n", file.c_str());
      return kExitFailed;
    }
    std::printf("%s\n", file.c_str());
  }
  return kExitDone;
}

}  // namespace

int picture_command(const PictureOptions& options) {
  const rig::Result<rig::RigFile> rig_file = rig::read_rig_file(options.rig_file);
  if (!rig_file) return complain(rig_file.error().detail);
  rig::Result<SimulatedRig> rig = simulated_rig(*rig_file);
  if (!rig) return complain(rig.error().detail);
  if (!rig->calibration.irradiance || rig->calibration.irradiance->signal_per_us.size() < 3)
    return complain(rig_file->calibration_file.string() +
                    " has no irradiance.signal_per_us of three bands");
  rig->camera.pixel_format = {estimation::ColorFilter::kRgb, 8};
  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  for (const std::string& name : options.scenes)
    if (const int exit_code = write_scene(name, options, *rig); exit_code != kExitDone)
      return exit_code;
  return kExitDone;
}

}  // namespace hw_sim
