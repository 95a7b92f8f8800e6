// What a merged sample's noise is, from the sensor's numbers or, without them, from the data.
#pragma once

#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "estimation/base/image.h"

namespace estimation {

struct SensorNoise {
  double gain_e_per_dn = 0;
  double read_noise_e = 0;
};

// Variance of a merged sample, (DN/us)^2: read_variance + shot_dn_per_us * signal, for signals up
// to up_to_dn_per_us: a bright sample has lost its long exposures.
struct MergedNoise {
  double up_to_dn_per_us = std::numeric_limits<double>::infinity();
  double read_variance = 0;
  double shot_dn_per_us = 0;
};

// One entry for each set of exposures that stays below saturation, the longest exposures first
// (rising up_to_dn_per_us; the last one holds for everything above). Same rule as merge_brackets.
// Quantisation to whole DN is included.
//   headroom_dn  saturation level minus black
std::vector<MergedNoise> merged_noise(std::vector<double> exposures_us, const SensorNoise& sensor,
                                      double headroom_dn);

// Of samples that were merged from different exposures, each `noise` as often as `share` says; at
// least one. Samples weighted alike are as noisy as this together.
struct SharedNoise {
  std::vector<MergedNoise> noise;
  double share = 0;  // of any sum
};
std::vector<MergedNoise> mean_noise(std::span<const SharedNoise> kinds);

// The same of samples that light was subtracted from which comes on top of their signals, DN/us: a
// black pattern's. It adds its shot noise, and saturation comes that much earlier.
std::vector<MergedNoise> above_background(std::vector<MergedNoise> noise,
                                          double background_dn_per_us);

// Of a sample whose expected signal this is. Near an entry's end noise decides which exposures stay
// below saturation: there the variance goes over to the next entry's linearly, over a width of
// kMixtureWidth standard deviations. An estimate weighted by a jump would have two solutions in one
// pixel of two hundred, up to 1.8 of its standard deviations apart.
inline constexpr double kMixtureWidth = 6;
double variance_at(std::span<const MergedNoise> noise, double signal_dn_per_us);

// The sensor whose samples merged from all of these exposures have this noise; nullopt if they show
// no shot noise, which leaves the gain open.
std::optional<SensorNoise> sensor_of(const MergedNoise& noise,
                                     std::span<const double> exposures_us);

// Noise from the scatter of adjacent stripe shifts, for cameras whose numbers are not known. A
// scattering profile is smooth from shift to shift and noise is not, so the median of the fourth
// differences of a pixel's samples tells its noise; the darkest shifts give the read noise, the
// brightest ones the shot noise. Too large where stripes are sharp.
//   signals          [shift] merged signals of adjacent shifts, at least 8
//   below_dn_per_us  brighter samples are left out: they have lost their long exposures
//   returns          nullopt if there is too little to tell
std::optional<MergedNoise> noise_from_stripes(std::span<const ImageView<const float>> signals,
                                              double below_dn_per_us);

}  // namespace estimation
