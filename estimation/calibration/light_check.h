// Is the projector's light what the patterns ask for: white and black that repeat, and greys that
// are not made by switching faster than the camera looks.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "estimation/calibration/measured.h"

namespace estimation {

// Two frames of one even picture, equally exposed, one after the other.
struct LightPair {
  double drive_frac = 1;  // what was asked for: 0 black, 1 white, between: a grey
  double exposure_us = 0;
  double rate_dn_per_us = 0;  // of both, over the lit field, camera black removed
  double change_frac = 0;     // of the colour that changed most, first to second, over white
  double scatter_frac = 0;  // of a pixel's difference beyond its colour's change, over sqrt 2 means
  double expected_frac = 0;  // of that, by photon and read noise
};

struct LightCheck {
  Measured white_dn_per_us, black_dn_per_us;            // sd: of the repeats
  double white_change_frac = 0, black_change_frac = 0;  // rms of the repeats about their mean
  Measured gamma;  // exponent of rate over drive, from the greys; 0 without any
  std::vector<std::string> warnings;
};

struct LightLimits {
  double change_frac = 0.003;  // of white
  double scatter_ratio = 1.5;  // of a pixel's scatter over the expected
};

// `pairs` of white and black at least once each, greys if there are any; otherwise what is missing
// is a warning.
LightCheck check_light(std::span<const LightPair> pairs, const LightLimits& limits);

}  // namespace estimation
