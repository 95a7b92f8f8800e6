// What a rig is shown for its calibration: plans for CaptureJob beside the paper's.
#pragma once

#include "capture/plan.h"
#include "rig/rig_file.h"

namespace capture {

// A board's pose: white, black, and the paper's patterns without its sweep (Gray code with its
// inverse and fine stripes of both axes, these at twice as many shifts), at the rig's exposures.
Plan board_plan(const rig::RigFile& rig_file);

// A target for light and optics: the paper's patterns, white and black. The sweep in its order: a
// target does not move.
Plan target_plan(const rig::RigFile& rig_file);

// The camera's exposures for its sensor: whole multiples of the rig's shortest one, since a
// projector's greys are even over whole refreshes alone.
std::vector<std::chrono::microseconds> series_exposures(const rig::RigFile& rig_file);

// Under the cap: black, four times, at those exposures.
Plan dark_plan(const rig::RigFile& rig_file);

// A steady scene: white, black, and greys of an eighth, a quarter and a half, each several times,
// at those exposures. White fills the range at the shortest one; the greys fill it at the others.
Plan series_plan(const rig::RigFile& rig_file);

}  // namespace capture
