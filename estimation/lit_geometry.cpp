#include "estimation/lit_geometry.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "estimation/profile/site_factors.h"
#include "estimation/radiometry/illumination.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

double sample(const Image<float>& image, int row, int col) {
  return static_cast<double>(image.empty() ? kNan : image.at(row, col));
}

}  // namespace

LitGeometry::LitGeometry(const MaterialInput& input, const Surface& surface, Axis axis)
    : axis_(axis),
      position_px_(axis == Axis::kColumn ? input.correspondence.column_px
                                         : input.correspondence.row_px),
      pitch_mm_(axis == Axis::kColumn ? surface.column_pitch_mm : surface.row_pitch_mm),
      gain_(surface.cos_projector.height_px(), surface.cos_projector.width_px(), 1, kNan),
      validity_(surface.validity) {
  const Correspondence& found = input.correspondence;
  const Illumination light{
      .vignetting = input.vignetting.view(),
      .reference_distance_mm = input.manifest.calibration.irradiance->reference_distance_mm};
  tbb::parallel_for(0, gain_.height_px(), [&](int row) {
    for (int col = 0; col < gain_.width_px(); ++col) {
      const double gain = light.at(
          sample(found.column_px, row, col), sample(found.row_px, row, col),
          sample(surface.cos_projector, row, col), sample(surface.projector_distance_mm, row, col));
      gain_.at(row, col) = static_cast<float>(gain);
      std::uint32_t& validity = validity_.at(row, col);
      const bool is_placed = gain > 0 && std::isfinite(sample(position_px_, row, col)) &&
                             std::isfinite(sample(pitch_mm_, row, col));
      if (!is_placed && (validity & kValidityErrors) == 0) validity |= kNoCorrespondence;
    }
  });
  geometry_ = {.position_px = position_px_.view(),
               .gain = gain_.view(),
               .projector_distance_mm = surface.projector_distance_mm.view(),
               .validity = validity_.view()};
  if (input.options.method == "lut" || !directionality_of(input.model).has_factors) return;
  azimuths_ = light_azimuths(input.manifest.calibration, input.manifest.camera, surface, axis);
  geometry_.directions = {.cos_incidence = surface.cos_projector.view(),
                          .cos_exit = surface.cos_camera.view(),
                          .incidence_azimuth_rad = azimuths_.incidence_rad.view(),
                          .exit_azimuth_rad = azimuths_.exit_rad.view()};
}

BandRadiometry radiometry_of(const MaterialInput& input, int band) {
  const auto of_band = [&](const std::vector<double>& values) {
    return values[std::min(static_cast<std::size_t>(band), values.size() - 1)];
  };
  const Calibration& calibration = input.manifest.calibration;
  const double signal_per_us = of_band(calibration.irradiance->signal_per_us);
  const std::vector<double>& black = calibration.projector_black_dn_per_us;
  // A black pattern's frames hold the projector's black already.
  const bool is_left_in = !input.signals.is_black_subtracted && !black.empty();
  return {.band = band,
          .signal_per_us = signal_per_us,
          .projector_black_frac = is_left_in ? of_band(black) / signal_per_us : 0,
          .noise = input.noise};
}

}  // namespace estimation
