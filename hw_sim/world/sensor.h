// The image sensor: photons to counts. Photon noise, read noise, full well, fixed pattern, hot
// pixels, black level, quantisation and clipping, with a random number per (seed, trigger, sample)
// instead of a generator's state, so that a frame does not depend on the order in which its pixels
// are made.
#pragma once

#include <cstdint>

#include "estimation/base/image.h"

namespace hw_sim {

struct SensorModel {
  double black_level_dn = 0;
  double gain_e_per_dn = 1;
  double read_noise_e = 0;
  int adc_max_dn = 4095;
  std::uint64_t seed = 0;
  double full_well_e = 0;         // 0: more than the converter counts
  double pixel_gain_sd_frac = 0;  // fixed pattern, the same in every frame
  double pixel_offset_sd_dn = 0;
  double hot_pixel_frac = 0;
  double hot_pixel_dn_per_s = 0;  // their mean; exponentially distributed

  // Samples [first, first + count) of a frame: `signal_dn` is the noiseless signal above black;
  // `exposure_s` what hot pixels take. Thread-safe.
  void digitise(const float* signal_dn, std::uint64_t trigger_number, std::int64_t first_sample,
                std::int64_t count, std::uint16_t* frame_dn, double exposure_s = 0) const;

 private:
  bool has_fixed_pattern() const {
    return pixel_gain_sd_frac > 0 || pixel_offset_sd_dn > 0 || hot_pixel_frac > 0;
  }
};

}  // namespace hw_sim
