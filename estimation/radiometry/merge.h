// Exposure brackets of one pattern to one linear signal, DN per microsecond.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "estimation/base/image.h"

namespace estimation {

// What the camera reads at zero light: one level, or dark frames taken at several exposures.
class CameraBlack {
 public:
  explicit CameraBlack(double level_dn) : level_dn_(level_dn) {}

  struct Dark {
    double exposure_us = 0;
    Image<std::uint16_t> dn;
  };
  // At least one, all of the frames' size. Darks of the same exposure are averaged. Between two
  // exposures the black is interpolated in time; beyond the ends the nearest dark holds.
  explicit CameraBlack(std::vector<Dark> darks);

  // The black of one row at one exposure, DN, into `out` (one value a sample).
  void row(double exposure_us, int row, std::span<float> out) const;

  bool is_one_level() const { return darks_.empty(); }  // whatever the exposure

  // Of an average pixel, for noise models. DN.
  double mean_dn(double exposure_us) const;

 private:
  struct Averaged {
    double exposure_us = 0;
    Image<float> dn;
    double mean_dn = 0;
  };
  struct Between {  // black = (1 - fraction) * lower + fraction * upper
    std::size_t lower = 0, upper = 0;
    double fraction = 0;
  };
  Between between(double exposure_us) const;

  double level_dn_ = 0;
  std::vector<Averaged> darks_;  // by rising exposure; empty: level_dn_ holds
};

struct ExposedFrame {
  double exposure_us = 0;
  ImageView<const std::uint16_t> dn;  // right-aligned, black not removed
};

// Signal rate of each sample: sum(DN - black) / sum(exposure) over the exposures in which the
// sample is below saturation, then divided by the flat field. For photon noise, whose variance
// grows with signal times exposure, this ratio of sums is the maximum likelihood estimate of the
// rate.
//   frames       of one pattern, any number and order; two of the same exposure are both used
//   flat_field   [height][width] relative to 1, or empty
//   returns      [height][width][channel] DN/us; NaN where every exposure is saturated or the flat
//                field is not positive. Does not depend on the order of `frames`, nor on the number
//                of threads (runs in the caller's oneTBB arena).
Image<float> merge_brackets(std::span<const ExposedFrame> frames, const CameraBlack& black,
                            double saturation_dn, ImageView<const float> flat_field);

// The same into the caller's memory, `rate` of the frames' size: a new image costs as much as the
// merge itself, because the system has to hand out its pages.
void merge_brackets_into(std::span<const ExposedFrame> frames, const CameraBlack& black,
                         double saturation_dn, ImageView<const float> flat_field,
                         ImageView<float> rate);

}  // namespace estimation
