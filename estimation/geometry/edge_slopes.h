// Slopes of a coarse camera's surface beside a border or a jump, where a least-squares window of a
// few points is a plane: differences over the points of a row or column that belong to the
// surface, and how far off their next order says they are.
#pragma once

#include "estimation/geometry/connected_fit.h"

namespace estimation {

// Immutable, so thread-safe; borrows the depth.
class EdgeSlopes {
 public:
  explicit EdgeSlopes(const Neighbours& neighbours) : neighbours_(neighbours) {}

  // `window`, a fit at the pixel, with whichever slopes have the least error in all, noise and what
  // their order leaves; its slope_gain then holds both.
  PointFit at(int row, int col, const PointFit& window) const;

 private:
  struct Slope {
    double value = 0, noise = 0, bias = 0;  // 1/(mm px)
    double error() const { return std::hypot(noise, bias); }
  };
  Slope along(int row, int col, int down, int right, Slope window) const;

  const Neighbours& neighbours_;
};

}  // namespace estimation
