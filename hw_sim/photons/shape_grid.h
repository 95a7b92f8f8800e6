// A shape sampled on a grid, for the millions of questions a photon asks: how far from the surface,
// and where outwards is. Trilinear between samples: at cells of 0.25 mm within 5 um of the shape
// where it curves with a radius of 3 mm, exact where it is flat. Outside its box it asks the shape.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "hw_sim/world/shape.h"

namespace hw_sim {

// Nodes of a regular grid and a place between eight of them.
class GridFrame {
 public:
  // Grows the box by less than a cell, to a whole number of cells.
  GridFrame(const Box& box, double cell_mm);

  struct Cell {
    std::size_t node = 0;              // the corner nearest the origin
    std::array<double, 3> fraction{};  // of the way to the opposite one
  };
  // False outside the box.
  bool locate(const estimation::Vec3& point_mm, Cell& cell) const;
  // The nearest place within the box.
  Cell nearest(const estimation::Vec3& point_mm) const;

  // Nodes in x run fastest.
  std::size_t node_count() const;
  int layer_count() const { return count_[2]; }
  std::size_t nodes_per_layer() const;
  estimation::Vec3 node_mm(std::size_t node) const;

  // The value between the eight nodes around.
  template <typename At>
  auto between(const Cell& cell, const At& at) const {
    const auto [x, y, z] = cell.fraction;
    const std::size_t n = cell.node, dy = step_y_, dz = step_z_;
    const auto along_x = [&](std::size_t from) { return at(from) * (1 - x) + at(from + 1) * x; };
    const auto near = along_x(n) * (1 - y) + along_x(n + dy) * y;
    const auto far = along_x(n + dz) * (1 - y) + along_x(n + dy + dz) * y;
    return near * (1 - z) + far * z;
  }

 private:
  estimation::Vec3 origin_;
  double cell_mm_, per_mm_;
  std::array<int, 3> count_{};  // nodes
  std::size_t step_y_ = 0, step_z_ = 0;
};

// Immutable, so thread-safe; refers to the shape, which must outlive it.
class ShapeGrid {
 public:
  // Runs in the caller's TBB arena; the same numbers for any number of threads.
  ShapeGrid(const Shape& shape, const Box& box, double cell_mm);

  const GridFrame& frame() const { return frame_; }
  // Negative inside.
  double distance_mm(const estimation::Vec3& point_mm) const;
  // Outward, a unit vector.
  estimation::Vec3 normal(const estimation::Vec3& point_mm) const;
  // The place on the surface below which the point lies.
  estimation::Vec3 on_surface(const estimation::Vec3& point_mm) const;

 private:
  // Normals are kept this near the surface; they are seldom asked for elsewhere.
  static constexpr double kNormalsWithinMm = 2;

  const Shape& shape_;
  GridFrame frame_;
  std::vector<float> distance_mm_;
  std::vector<std::array<float, 3>> normals_;  // zero where not kept
};

}  // namespace hw_sim
