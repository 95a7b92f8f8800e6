// What the check of frames against each other finds when the frames of a capture that is right are
// made wrong, one at a time.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "estimation/motion/picture_identity.h"
#include "estimation/session/manifest.h"

namespace bench {

struct SwapTally {
  int slot_count = 0, checked_count = 0;
  int found_count = 0;       // the slot is named
  int alone_count = 0;       // of those: and no other
  int undetected_count = 0;  // nothing is named at all
  std::vector<std::string> missed;
};

// Each slot in turn shows `share_frac` of the picture before it in the order of showing.
SwapTally try_swaps(const estimation::CameraInfo& camera,
                    const std::vector<estimation::Pattern>& patterns,
                    const std::vector<estimation::SeenPicture>& pictures, double share_frac);

}  // namespace bench
