// How bright the projector's light is, from the reflectance standard: signal_per_us, vignetting in
// projector px, projector black.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/calibration/measured.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// The flat standard in one place, under white, and where it is. All [height][width] of the frames.
struct StandardView {
  // [channel] DN/us with the black pattern's signal subtracted; NaN where saturated.
  ImageView<const float> white;
  ImageView<const float> black;  // camera black removed: projector black and ambient; or empty
  ImageView<const float> column_px, row_px;           // as decoded
  std::array<ImageView<const float>, 3> position_mm;  // as reconstructed; NaN: no surface
};

struct StandardOptions {
  std::array<double, 3> reflectance{0.99, 0.99, 0.99};  // of the standard, by band
  // This near its border the standard loses light (it scatters) and is left out.
  double border_mm = 6;
  // Pixels darker than this share of the bright ones are not the standard.
  double least_level_frac = 0.5;
};

struct IlluminationFit {
  int band_count = 1;
  std::array<Measured, 3> signal_per_us;  // DN/us, see session_format.md
  double reference_distance_mm = 0;       // the standard's mean
  std::array<Measured, 3> projector_black_dn_per_us;
  bool has_black = false;
  Image<float> vignetting;  // [projector height][width], 1 at the centre
  int order = 0;            // of the polynomial that it is
  // The part of the projector's picture that was seen; beyond it the border holds.
  double first_column_px = 0, last_column_px = 0, first_row_px = 0, last_row_px = 0;
  struct Cell {  // of the projector's picture: mean of the standard there
    double column_px = 0, row_px = 0;
    int band = 0;
    double signal_per_us = 0;  // with vignetting
    double residual_frac = 0;  // over the fit
  };
  std::vector<Cell> cells;
  double residual_rms_frac = 0;
  double flatness_mm = 0;  // rms of the standard's points about its plane
  std::vector<std::string> warnings;
};

// The camera's own vignetting is not told apart: give frames divided by its flat field. Errors:
// kInsufficient where too little of the standard is seen.
Result<IlluminationFit> fit_illumination(std::span<const StandardView> views,
                                         const Calibration& calibration, const CameraInfo& camera,
                                         const ProjectorInfo& projector,
                                         const StandardOptions& options);

}  // namespace estimation
