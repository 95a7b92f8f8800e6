// A window of a simulated camera's picture, by both of the simulator's light transports: the
// surface's, which the virtual rig uses, and photons through the volume, its judge.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "estimation/session/manifest.h"
#include "hw_sim/photons/pixel_response.h"

namespace bench {

struct WindowPlan {
  std::string name;  // of files and in tables
  std::string title;
  std::string scene;                              // of hw_sim/world/scene.h
  hw_sim::Region inside = hw_sim::Region::kNone;  // whose border is looked at
  int row_px = 0, col_px = 0;                     // the window's middle on the sensor of 588 x 432
  int height_px = 32, width_px = 32;              // the window's size
};

struct WindowOptions {
  int paths_per_sample = 2048;
  bool has_indirect = false;          // light that leaves the skin and meets it again
  int photons_per_angle = 3'000'000;  // of the surface way's table
  int thread_count = 2;
  std::filesystem::path cache_folder;  // of the surface way
};

struct WindowPixel {
  int row = 0, col = 0, band = 0;
  hw_sim::Scattering scattering;  // of its band, where it looks
  bool is_inside = false;         // of the plan's region, where materials mix by the larger share
  // To the nearest zone of mixed materials, and to the nearest place where surface or light break
  // off: a jump in depth, a shadow's edge; at most kFarMm.
  double border_distance_mm = 0, break_distance_mm = 0;
  double cos_projector = 0;
  bool is_lit = false;
};
inline constexpr double kFarMm = 15;

// What one way says: reflectance factors under each pattern, irradiance not normalised.
using Signals = std::vector<std::vector<double>>;  // [pattern][pixel]

struct Window {
  WindowPlan plan;
  estimation::Manifest manifest;    // without frames
  std::vector<WindowPixel> pixels;  // that see the subject, in pixel order
  Signals surface, photons, photons_se;
  std::vector<double> level_se;  // [pixel] of the photons' mean over a period of stripes
  Signals half;                  // of the photons: every other batch
  double photon_cpu_s = 0;
  std::size_t path_count = 0;
};

// config/simulated.toml's rig, its camera looking through the window; without frames.
inline constexpr int kProjectorHeight = 768, kProjectorWidth = 1024;
estimation::Manifest manifest_of(const WindowPlan& plan);

// Columns alone: stripes and Gray code of the paper's plan. Ends the program on an error.
Window measure(const WindowPlan& plan, const WindowOptions& options);

}  // namespace bench
