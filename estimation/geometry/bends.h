// How a surface bends, and how the light on it changes, along and across the stripes that a
// projector throws on it.
#pragma once

#include <array>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/surface.h"
#include "estimation/geometry/triangulation.h"
#include "estimation/session/pattern.h"

namespace estimation {

// How surface and light change along the stripes' gradient q (unit, on the surface) and across it.
struct Bend {
  float is_known = 0;
  float gradient_px_per_mm = 0;  // of the projector's coordinate along q
  float light_per_mm = 0;        // relative change of the irradiance along q
  float along_px_per_mm2 = 0;    // second derivative of the coordinate on the surface along q
  float across_px_per_mm2 = 0;   // and across
  // Of the coordinate, were the light to come out displaced towards the device by a mm times the
  // sine of its direction.
  float projector_px = 0, camera_px = 0;
};

// At nodes `side_px` apart, in the middle of the spread's cells.
struct BendNodes {
  int side_px = 1, rows = 0, cols = 0;
  std::vector<Bend> nodes;

  const Bend& node(int row, int col) const {
    return nodes[static_cast<std::size_t>(row) * static_cast<std::size_t>(cols) +
                 static_cast<std::size_t>(col)];
  }

  // Between the nodes around, those that are known; is_known is 0 if none is.
  Bend at(int row, int col) const;
};

// Of a surface, averaged over `radius_px` of the frame around each node; a node whose surroundings
// are not known has is_known 0. Runs in the caller's oneTBB arena.
BendNodes bends_of(const Stereo& stereo, const Surface& surface, Axis axis, int radius_px,
                   int side_px);

// A pixel's position or normal; NaN where there is none.
Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col);

}  // namespace estimation
