// When a picture's light comes, beyond its moment on the LightTimeline.
#pragma once

#include <algorithm>
#include <chrono>

#include "rig/projector.h"

namespace hw_sim {

struct LampTiming {
  int input_lag_refreshes = 0;          // beyond the display's own
  std::chrono::nanoseconds scanout{0};  // from the light of a picture's first row to its last's
};

// From a picture's moment until the middle of its sync square is lit.
inline std::chrono::nanoseconds square_delay(const LampTiming& timing,
                                             const rig::SyncSquareSettings& square, int height_px) {
  const bool is_bottom =
      square.corner == rig::Corner::kBottomLeft || square.corner == rig::Corner::kBottomRight;
  const int middle_px = std::min(square.size_px, height_px) / 2;
  return timing.scanout * (is_bottom ? height_px - middle_px : middle_px) / std::max(height_px, 1);
}

}  // namespace hw_sim
