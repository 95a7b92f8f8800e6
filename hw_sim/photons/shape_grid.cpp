#include "hw_sim/photons/shape_grid.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace hw_sim {

using estimation::Vec3;

GridFrame::GridFrame(const Box& box, double cell_mm)
    : origin_(box.low_mm), cell_mm_(cell_mm), per_mm_(1 / cell_mm) {
  for (int axis = 0; axis < 3; ++axis)
    count_[static_cast<std::size_t>(axis)] =
        1 +
        std::max(1, static_cast<int>(std::ceil((box.high_mm[axis] - box.low_mm[axis]) / cell_mm)));
  step_y_ = static_cast<std::size_t>(count_[0]);
  step_z_ = step_y_ * static_cast<std::size_t>(count_[1]);
}

std::size_t GridFrame::node_count() const { return step_z_ * static_cast<std::size_t>(count_[2]); }
std::size_t GridFrame::nodes_per_layer() const { return step_z_; }

Vec3 GridFrame::node_mm(std::size_t node) const {
  const std::size_t column = node % step_y_, row = node % step_z_ / step_y_, layer = node / step_z_;
  return origin_ + cell_mm_ * Vec3(static_cast<double>(column), static_cast<double>(row),
                                   static_cast<double>(layer));
}

bool GridFrame::locate(const Vec3& point_mm, Cell& cell) const {
  const std::array<std::size_t, 3> steps = {1, step_y_, step_z_};
  cell.node = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const int a = static_cast<int>(axis);
    const double at = (point_mm[a] - origin_[a]) * per_mm_;
    if (!(at >= 0 && at < count_[axis] - 1)) return false;
    const auto below = static_cast<std::size_t>(at);
    cell.node += below * steps[axis];
    cell.fraction[axis] = at - static_cast<double>(below);
  }
  return true;
}

GridFrame::Cell GridFrame::nearest(const Vec3& point_mm) const {
  Vec3 inside;
  for (int axis = 0; axis < 3; ++axis) {
    const double high = origin_[axis] + cell_mm_ * (count_[static_cast<std::size_t>(axis)] - 1.001);
    inside[axis] = std::clamp(point_mm[axis], origin_[axis], high);
  }
  Cell cell;
  locate(inside, cell);
  return cell;
}

ShapeGrid::ShapeGrid(const Shape& shape, const Box& box, double cell_mm)
    : shape_(shape), frame_(box, cell_mm), nodes_(frame_.node_count(), {0, 0, 0, 0}) {
  tbb::parallel_for(0, frame_.layer_count(), [&](int layer) {
    const std::size_t begin = static_cast<std::size_t>(layer) * frame_.nodes_per_layer();
    for (std::size_t node = begin; node < begin + frame_.nodes_per_layer(); ++node) {
      const Vec3 point = frame_.node_mm(node);
      const double distance = shape.distance_mm(point);
      nodes_[node][3] = static_cast<float>(distance);
      if (std::abs(distance) > kNormalsWithinMm) continue;
      const Vec3 normal = normal_at(shape, point);
      for (std::size_t axis = 0; axis < 3; ++axis)
        nodes_[node][axis] = static_cast<float>(normal[static_cast<int>(axis)]);
    }
  });
}

ShapeGrid::Place ShapeGrid::at(const Vec3& point_mm) const {
  GridFrame::Cell cell;
  if (!frame_.locate(point_mm, cell))
    return {shape_.distance_mm(point_mm), normal_at(shape_, point_mm)};
  const std::array<float, 4> sum = frame_.between(cell, nodes_);
  const auto distance = static_cast<double>(sum[3]);
  // Two cells away all eight nodes have theirs.
  if (std::abs(distance) > kNormalsWithinMm - 2 * frame_.cell_mm())
    return {distance, normal_at(shape_, point_mm)};
  const Vec3 normal(static_cast<double>(sum[0]), static_cast<double>(sum[1]),
                    static_cast<double>(sum[2]));
  return {distance, normal / std::sqrt(normal.dot(normal))};
}

double ShapeGrid::distance_mm(const Vec3& point_mm) const {
  GridFrame::Cell cell;
  if (!frame_.locate(point_mm, cell)) return shape_.distance_mm(point_mm);
  return static_cast<double>(frame_.between(cell, nodes_)[3]);
}

Vec3 ShapeGrid::on_surface(const Vec3& point_mm) const {
  Vec3 point = point_mm;
  // Each step removes the distance; a shape's is exact near its surface only.
  for (int i = 0; i < 4; ++i) {
    const Place place = at(point);
    point -= place.distance_mm * place.normal;
    if (std::abs(place.distance_mm) < 1e-6) break;
  }
  return point;
}

}  // namespace hw_sim
