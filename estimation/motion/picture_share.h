// How much of a frame's light is another picture's. Private to estimation/motion.
#pragma once

#include <vector>

namespace estimation {

using PlaceLight = std::vector<float>;  // [place] DN above black

// How much of a frame's light another picture would have, if it were one.
struct PictureShare {
  double frac = 0;       // by places that would be brighter and darker alike
  double explained = 0;  // of the surplus' square
  double surplus_square = 0, change_square = 0;
  bool is_visible = false;
};

// `surplus` = seen less expected, `change` = the other picture less expected; `light` white +
// black. Standard deviations and sides decide whether it is one at all: else the share is 0.
PictureShare share_of(const PlaceLight& surplus, const PlaceLight& change, const PlaceLight& light);

}  // namespace estimation
