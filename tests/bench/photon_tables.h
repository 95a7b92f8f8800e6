// Surface against photons in windows of a face: tables and pictures.
#pragma once

#include <filesystem>
#include <vector>

#include "tests/bench/photon_estimates.h"
#include "tests/bench/photon_window.h"
#include "tests/bench/report.h"

namespace bench {

// How one pixel's stripe profile by the surface way differs from the photons', relative to the
// surface's mean: it has no noise.
struct ProfileDifference {
  double level = 0, level_se = 0;  // of the mean over the period
  double shape = 0, shape_se = 0;  // root mean square over the 40 shifts, means included
};

struct WindowResult {
  Window window;
  std::vector<ProfileDifference> profiles;                       // by pixel
  std::vector<Recovered> from_surface, from_photons, from_half;  // by pixel
};

WindowResult judge(Window window, const WindowOptions& options);

// Tables, with a CSV of every pixel, and the window's picture.
void show_window(Report& report, const WindowResult& result, const std::filesystem::path& folder);

// One PNG with all windows, one below the other.
void write_sheet(Report& report, const std::vector<WindowResult>& results,
                 const std::filesystem::path& folder);

// What show_window draws.
void write_picture(Report& report, const WindowResult& result, const std::filesystem::path& folder);

}  // namespace bench
