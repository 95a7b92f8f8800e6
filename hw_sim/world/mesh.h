// Triangles on a shape's surface, for ray queries.
#pragma once

#include <array>
#include <vector>

#include "hw_sim/world/shape.h"

namespace hw_sim {

struct Mesh {
  std::vector<std::array<float, 3>> vertices_mm;  // three per triangle, not shared
  int triangle_count() const { return static_cast<int>(vertices_mm.size() / 3); }
  estimation::Vec3 vertex(int index) const {
    const auto& v = vertices_mm[static_cast<std::size_t>(index)];
    return {static_cast<double>(v[0]), static_cast<double>(v[1]), static_cast<double>(v[2])};
  }
};

// Marching tetrahedra over a grid of cells of side `cell_mm`; neighbouring triangles share their
// edges to the last bit, so that no ray slips through. Runs in the caller's TBB arena; the same
// triangles in the same order for any number of threads.
Mesh make_mesh(const Shape& shape, double cell_mm);

}  // namespace hw_sim
