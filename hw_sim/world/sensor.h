// The image sensor: photons to counts. Photon noise, read noise, black level, quantisation and
// clipping, with a random number per (seed, trigger, sample) instead of a generator's state, so
// that a frame does not depend on the order in which its pixels are made.
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

  // Samples [first, first + count) of a frame: `signal_dn` is the noiseless signal above black.
  // Thread-safe.
  void digitise(const float* signal_dn, std::uint64_t trigger_number, std::int64_t first_sample,
                std::int64_t count, std::uint16_t* frame_dn) const;
};

}  // namespace hw_sim
