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

  double cell_mm() const { return cell_mm_; }
  // Nodes in x run fastest.
  std::size_t node_count() const;
  int layer_count() const { return count_[2]; }
  std::size_t nodes_per_layer() const;
  estimation::Vec3 node_mm(std::size_t node) const;

  // The values between the eight nodes around.
  template <std::size_t kCount>
  std::array<float, kCount> between(const Cell& cell,
                                    const std::vector<std::array<float, kCount>>& nodes) const {
    std::array<float, kCount> sum{};
    for (std::size_t corner = 0; corner < 8; ++corner) {
      const bool is_right = (corner & 1) != 0, is_up = (corner & 2) != 0, is_far = corner >= 4;
      const double weight = (is_right ? cell.fraction[0] : 1 - cell.fraction[0]) *
                            (is_up ? cell.fraction[1] : 1 - cell.fraction[1]) *
                            (is_far ? cell.fraction[2] : 1 - cell.fraction[2]);
      const std::array<float, kCount>& node =
          nodes[cell.node + (is_right ? 1 : 0) + (is_up ? step_y_ : 0) + (is_far ? step_z_ : 0)];
      for (std::size_t i = 0; i < kCount; ++i) sum[i] += static_cast<float>(weight) * node[i];
    }
    return sum;
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

  struct Place {
    double distance_mm = 0;   // negative inside
    estimation::Vec3 normal;  // outward, a unit vector
  };

  const GridFrame& frame() const { return frame_; }
  Place at(const estimation::Vec3& point_mm) const;
  double distance_mm(const estimation::Vec3& point_mm) const;
  estimation::Vec3 normal(const estimation::Vec3& point_mm) const { return at(point_mm).normal; }
  // The place on the surface below which the point lies.
  estimation::Vec3 on_surface(const estimation::Vec3& point_mm) const;

 private:
  // Normals are kept this near the surface; they are seldom asked for elsewhere.
  static constexpr double kNormalsWithinMm = 2.5;

  const Shape& shape_;
  GridFrame frame_;
  // Normal, zero where not kept, and distance.
  std::vector<std::array<float, 4>> nodes_;
};

}  // namespace hw_sim
