// Isolated decoding errors found by their neighbours.
#pragma once

#include "estimation/base/image.h"

namespace estimation {

// 1 where at least `min_support_frac` of the decoded pixels in the 7 x 7 around (and at least four)
// continue the pixel's own surface, 0 elsewhere.
//   position_px  [height][width] projector column or row; NaN: not decoded
Image<unsigned char> find_supported(ImageView<const float> position_px, double min_support_frac);

}  // namespace estimation
