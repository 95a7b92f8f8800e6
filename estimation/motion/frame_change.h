// What changed between two showings of one pattern: where the picture has moved, how the light
// changed, and which places changed by themselves. Pure: arrays in, numbers out.
#pragma once

#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// A connected place whose light changed otherwise than the rest: a blink, a strand of hair.
struct LocalChange {
  double row_px = 0, col_px = 0;        // its centre in the frame
  double height_px = 0, width_px = 0;   // the box around it
  double height_frac = 0;               // of its centre in the lit part, 0 the top, 1 the bottom
  double change_frac = 0, sd_frac = 0;  // of its light, where it changed most
};

// Pixels are the frame's; shares of light are of the mean of the lit part in the first showing.
// Standard deviations are those of the fit, from how much its blocks contradict each other.
struct FrameChange {
  double lit_frac = 0;  // of the frame: lit, and clipped in neither
  // Of the picture as a whole, from the first showing to the second.
  double shift_row_px = 0, shift_row_sd_px = 0;
  double shift_col_px = 0, shift_col_sd_px = 0;
  // Root mean square over the lit blocks of the shift across their strongest edges, noise taken
  // off: a head that turns, or moves sideways under stripes, moves its parts apart.
  double local_shift_px = 0;
  double light_frac = 0, light_sd_frac = 0;      // the projector's: second over first, less 1
  double ambient_frac = 0, ambient_sd_frac = 0;  // light that came in beside it
  double residual_frac = 0;  // of the picture's variation (root mean square): not explained so
  std::vector<LocalChange> local_changes;  // the largest first
};

// Frames as [height][width][channel] DN, of one pattern and one exposure. Shift, gain and offset
// are fitted together by weighted least squares on the smoothed picture, outliers held down.
// Errors: kInvalid where the sizes differ from the camera's; kInsufficient where too little is lit
// to compare, or no shift makes the two alike.
// `period_px`: of the pattern as the frame shows it, roughly; 0 for one that is lit all over. The
// mean over it tells what the skin gives back of light that comes from everywhere.
Result<FrameChange> measure_change(const CameraInfo& camera, double period_px,
                                   ImageView<const std::uint16_t> first,
                                   ImageView<const std::uint16_t> second);

}  // namespace estimation
