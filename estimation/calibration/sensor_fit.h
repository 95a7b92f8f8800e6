// The camera's sensor from frames of a steady scene: black level, linearity over exposure, and by
// the photon transfer curve gain and read noise.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/calibration/measured.h"
#include "estimation/session/error.h"

namespace estimation {

// One frame of a series: the same scene under the same light throughout, or no light at all.
struct SeriesFrame {
  double exposure_us = 0;
  bool is_dark = false;               // lens capped, or everything off
  ImageView<const std::uint16_t> dn;  // right-aligned, black not removed
};

struct SensorFit {
  Measured black_level_dn;         // at no exposure
  Measured dark_signal_dn_per_us;  // what darkness adds with exposure; 0 of one dark exposure
  Measured gain_e_per_dn;
  Measured read_noise_e;
  // Largest deviation of a class of pixels from proportionality to exposure, above 5% of the range.
  Measured linearity_max_frac;

  struct PhotonPoint {
    double signal_dn = 0, variance_dn2 = 0, fitted_dn2 = 0;
    double sample_count = 0;
  };
  std::vector<PhotonPoint> photon_transfer;  // by rising signal
  struct LinearityPoint {
    double exposure_us = 0, signal_dn = 0, deviation_frac = 0;
  };
  std::vector<LinearityPoint> linearity;
  std::vector<std::string> warnings;
};

// Which of the 2 x 2 sites of a mosaic, and of its channels, a row's sample is of: 0 to 4 channels
// - 1. Colours apart, whatever the mosaic.
inline std::size_t mosaic_site(int row, std::size_t sample, int channel_count) {
  const auto channels = static_cast<std::size_t>(channel_count);
  const std::size_t col = sample / channels;
  return (static_cast<std::size_t>(row % 2) * 2 + col % 2) * channels + sample % channels;
}

// Needs dark frames, two or more frames of at least one exposure in the light (for noise), and two
// or more exposures (for linearity; else a warning and 0). Errors: kInsufficient, kInvalid.
Result<SensorFit> fit_sensor(std::span<const SeriesFrame> frames, double saturation_dn);

}  // namespace estimation
