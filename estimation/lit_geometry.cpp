#include "estimation/lit_geometry.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "estimation/geometry/triangulation.h"
#include "estimation/profile/site_factors.h"
#include "estimation/radiometry/illumination.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

double sample(const Image<float>& image, int row, int col) {
  return static_cast<double>(image.empty() ? kNan : image.at(row, col));
}

// Where in the projector a pixel is lit from: as decoded, and along an axis that does not tell it
// as the surface has it.
class LitPlaces {
 public:
  LitPlaces(const MaterialInput& input, const Surface& surface)
      : found_(input.correspondence),
        surface_(surface),
        stereo_(input.manifest.calibration, input.manifest.camera) {}

  struct Place {
    double column_px = kNan, row_px = kNan;
  };

  Place at(int row, int col) const {
    Place place{sample(found_.column_px, row, col), sample(found_.row_px, row, col)};
    if (std::isfinite(place.column_px) && std::isfinite(place.row_px)) return place;
    Vec3 point_mm;
    for (std::size_t i = 0; i < 3; ++i)
      point_mm[static_cast<int>(i)] = sample(surface_.position_mm[i], row, col);
    if (const auto lit = stereo_.project(point_mm)) {
      if (!std::isfinite(place.column_px)) place.column_px = lit->pixel[0];
      if (!std::isfinite(place.row_px)) place.row_px = lit->pixel[1];
    }
    return place;
  }

 private:
  const Correspondence& found_;
  const Surface& surface_;
  Stereo stereo_;
};

}  // namespace

LitGeometry::LitGeometry(const MaterialInput& input, const Surface& surface, Axis axis)
    : axis_(axis),
      position_px_(axis == Axis::kColumn ? input.correspondence.column_px
                                         : input.correspondence.row_px),
      pitch_mm_(axis == Axis::kColumn ? surface.column_pitch_mm : surface.row_pitch_mm),
      gain_(surface.cos_projector.height_px(), surface.cos_projector.width_px(), 1, kNan),
      validity_(surface.validity) {
  const LitPlaces places(input, surface);
  const Illumination light{
      .vignetting = input.vignetting.view(),
      .reference_distance_mm = input.manifest.calibration.irradiance->reference_distance_mm};
  tbb::parallel_for(0, gain_.height_px(), [&](int row) {
    for (int col = 0; col < gain_.width_px(); ++col) {
      if ((validity_.at(row, col) & kValidityErrors) != 0) continue;
      const LitPlaces::Place place = places.at(row, col);
      const double gain =
          light.at(place.column_px, place.row_px, sample(surface.cos_projector, row, col),
                   sample(surface.projector_distance_mm, row, col));
      gain_.at(row, col) = static_cast<float>(gain);
      std::uint32_t& validity = validity_.at(row, col);
      const bool is_placed = gain > 0 && std::isfinite(sample(position_px_, row, col)) &&
                             std::isfinite(sample(pitch_mm_, row, col));
      if (!is_placed) validity |= kNoCorrespondence;
    }
  });
  geometry_ = {.position_px = position_px_.view(),
               .gain = gain_.view(),
               .projector_distance_mm = surface.projector_distance_mm.view(),
               .validity = validity_.view()};
  if (input.options.method == "lut") return;
  fill_tilt(input, surface);
  if (!directionality_of(input.model).has_factors) return;
  azimuths_ = light_azimuths(input.manifest.calibration, input.manifest.camera, surface, axis);
  geometry_.directions = {.cos_incidence = surface.cos_projector.view(),
                          .cos_exit = surface.cos_camera.view(),
                          .incidence_azimuth_rad = azimuths_.incidence_rad.view(),
                          .exit_azimuth_rad = azimuths_.exit_rad.view()};
}

// With g the gradient of the projector's coordinate and l the direction to the projector, g . l =
// 0; so of the tangent of incidence the part along the stripes' axis is g's part along the normal
// over its tangential part, whose inverse is the pitch.
void LitGeometry::fill_tilt(const MaterialInput& input, const Surface& surface) {
  const cv::Matx33d& K = input.manifest.calibration.projector.K;
  const LitPlaces places(input, surface);
  tilt_along_ = Image<float>(gain_.height_px(), gain_.width_px(), 1, kNan);
  tilt_across_ = tilt_along_;
  tbb::parallel_for(0, gain_.height_px(), [&](int row) {
    for (int col = 0; col < gain_.width_px(); ++col) {
      if ((validity_.at(row, col) & kValidityErrors) != 0) continue;
      const LitPlaces::Place place = places.at(row, col);
      const double x = (place.column_px - K(0, 2)) / K(0, 0);
      const double y = (place.row_px - K(1, 2)) / K(1, 1);
      const bool is_column = axis_ == Axis::kColumn;
      const double focal_px = is_column ? K(0, 0) : K(1, 1), on_axis = is_column ? x : y;
      const double gradient_px_per_mm = focal_px *
                                        std::sqrt((1 + x * x + y * y) * (1 + on_axis * on_axis)) /
                                        sample(surface.projector_distance_mm, row, col);
      const double pitch_mm = sample(pitch_mm_, row, col);
      const double cosine = sample(surface.cos_projector, row, col);
      const double tangent2 = 1 / (cosine * cosine) - 1;
      const double along2 =
          std::clamp(std::pow(gradient_px_per_mm * pitch_mm, 2) - 1, 0.0, std::max(tangent2, 0.0));
      const double tilt_sd_rad = sample(surface.tilt_sd_rad, row, col);
      tilt_along_.at(row, col) = static_cast<float>(tilt_sd_rad * std::sqrt(along2));
      tilt_across_.at(row, col) =
          static_cast<float>(tilt_sd_rad * std::sqrt(std::max(tangent2 - along2, 0.0)));
    }
  });
  geometry_.tilt = {.along = tilt_along_.view(), .across = tilt_across_.view()};
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
          .noise = input.noise,
          .common_variance = input.common_variance};
}

}  // namespace estimation
