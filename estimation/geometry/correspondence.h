// Which projector pixel lit each camera pixel, from the patterns' signals: Gray code tells the
// periods apart, the phases of stripes and fringes give the sub-pixel part.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"
#include "estimation/session/pattern.h"

namespace estimation {

// One pattern as the camera saw it.
//   signal  [height][width] DN/us, linear, exposures merged, black removed where known; one sample
//   a
//           pixel: a Bayer site's own colour, one band (or the bands' mean) of an RGB frame; NaN
//           where no exposure was usable (saturated)
//   frames  or the pattern's frames instead, any exposures, one sample a pixel: they are merged on
//           the way, as merge_brackets would without a flat field, and need no memory of their own
// Patterns may come in any order, any subset of them; two signals of the same pattern are averaged,
// frames of the same pattern are one bracket.
struct PatternSignal {
  const PatternKind* kind = nullptr;
  ImageView<const float> signal;
  std::span<const ExposedFrame> frames = {};
};

// What the camera's samples mean.
struct FrameLevels {
  const CameraBlack* black = nullptr;
  double saturation_dn = 0;  // a sample is lost from here on
};

struct CorrespondenceOptions {
  // As merged_noise() makes it; at least one entry. All zero is allowed: then the standard
  // deviations are the systematic part alone.
  std::vector<MergedNoise> noise{MergedNoise{}};
  FrameLevels levels;  // where frames are given
  // Lit: the projector's modulation is this many standard deviations, and this share of the 99th
  // percentile of all pixels' modulations (stray light at the far wall is not the subject).
  double min_modulation_sd = 5;
  double min_modulation_frac = 0.005;
  double max_sd_px = 1;  // a coarser phase is "too dark"; Gray code alone is exempt
  // What optics and skin blur at the very least, projector px: decides how far a pattern's upper
  // harmonics can mislead a phase sampled at few shifts.
  double least_blur_px = 1;
  // Log-likelihood by which the best period must beat the second best. Clear Gray bits give 16 and
  // more, a transition read at a quarter of its contrast 4.
  double min_period_margin = 4;
  // A pixel is kept if this share of the decoded pixels around it (7 x 7) lie on the same surface.
  double min_support_frac = 0.25;
};

// All images [height][width] of the signals. An axis without usable patterns has empty images.
struct Correspondence {
  Image<float> column_px, row_px;  // projector px, pixel centres at integers; NaN: not decoded
  Image<float> column_sd_px, row_sd_px;  // standard deviation: noise and aliasing; NaN likewise
  // White minus black as the clearest pattern tells it, DN/us, whatever the axis; 0: nothing seen.
  Image<float> modulation_dn_per_us;
  // 0 or errors of Validity: kBackground (not lit), kSaturated (too many samples lost), kTooDark,
  // kNoCorrespondence. A pixel with any error is NaN in every axis; one without may be NaN in an
  // axis whose patterns do not place every pixel (some are missing).
  Image<std::uint32_t> validity;
  std::vector<std::string> notes;  // what could not be decoded and why, for people
};

// Needs at least one signal; all of one size. Same result for any number of threads. Thread-safe.
Correspondence decode_correspondence(std::span<const PatternSignal> signals,
                                     const ProjectorInfo& projector,
                                     const CorrespondenceOptions& options);

}  // namespace estimation
