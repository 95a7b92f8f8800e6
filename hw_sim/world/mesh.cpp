#include "hw_sim/world/mesh.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace hw_sim {

using estimation::Vec3;

namespace {

struct Corner {
  Vec3 point;
  double distance = 0;
};
using Cube = std::array<Corner, 8>;  // corner index: x + 2 y + 4 z

// The six tetrahedra around a cube's diagonal 0-7; the same split in every cube, so faces match.
constexpr int kTetrahedra[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                   {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};

std::array<float, 3> crossing(const Corner& a, const Corner& b) {
  // Both cubes at an edge must compute the same bits: always from the inner corner to the outer.
  const Corner& in = a.distance < 0 ? a : b;
  const Corner& out = a.distance < 0 ? b : a;
  const double fraction = in.distance / (in.distance - out.distance);
  const Vec3 point = in.point + fraction * (out.point - in.point);
  return {static_cast<float>(point[0]), static_cast<float>(point[1]), static_cast<float>(point[2])};
}

void add_tetrahedron(const std::array<const Corner*, 4>& corners,
                     std::vector<std::array<float, 3>>& vertices) {
  std::array<const Corner*, 4> inner{}, outer{};
  std::size_t inner_count = 0, outer_count = 0;
  for (const Corner* corner : corners)
    (corner->distance < 0 ? inner[inner_count++] : outer[outer_count++]) = corner;
  const auto add = [&](const Corner* a0, const Corner* a1, const Corner* b0, const Corner* b1,
                       const Corner* c0, const Corner* c1) {
    vertices.push_back(crossing(*a0, *a1));
    vertices.push_back(crossing(*b0, *b1));
    vertices.push_back(crossing(*c0, *c1));
  };
  if (inner_count == 1) {
    add(inner[0], outer[0], inner[0], outer[1], inner[0], outer[2]);
  } else if (inner_count == 3) {
    add(outer[0], inner[0], outer[0], inner[1], outer[0], inner[2]);
  } else if (inner_count == 2) {
    add(inner[0], outer[0], inner[0], outer[1], inner[1], outer[1]);
    add(inner[0], outer[0], inner[1], outer[1], inner[1], outer[0]);
  }
}

struct Grid {
  const Shape& shape;
  Vec3 origin;
  double cell_mm;
  static constexpr int kBlock = 4;  // cells along a block's side

  Vec3 point(int x, int y, int z) const {
    return origin + Vec3(x * cell_mm, y * cell_mm, z * cell_mm);
  }
  bool may_hold_surface(int bx, int by, int bz) const {
    const double half = kBlock * cell_mm / 2;
    const Vec3 center = point(bx * kBlock, by * kBlock, bz * kBlock) + Vec3::all(half);
    // The shapes' "distance" is not quite one where features blend: 1.8 finds the same triangles
    // as 5.
    return std::abs(shape.distance_mm(center)) < 1.8 * std::sqrt(3.0) * half;
  }
  void add_block(int bx, int by, int bz, std::vector<std::array<float, 3>>& vertices) const {
    constexpr int kSide = kBlock + 1;
    std::vector<double> distance(std::size_t{kSide} * kSide * kSide);
    const auto index = [](int x, int y, int z) {
      const int corner = (z * kSide + y) * kSide + x;
      return static_cast<std::size_t>(corner);
    };
    for (int z = 0; z < kSide; ++z)
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x)
          distance[index(x, y, z)] =
              shape.distance_mm(point(bx * kBlock + x, by * kBlock + y, bz * kBlock + z));
    for (int z = 0; z < kBlock; ++z)
      for (int y = 0; y < kBlock; ++y)
        for (int x = 0; x < kBlock; ++x) {
          Cube cube;
          int inside_count = 0;
          for (int i = 0; i < 8; ++i) {
            const int cx = x + (i & 1), cy = y + (i >> 1 & 1), cz = z + (i >> 2);
            Corner& corner = cube[static_cast<std::size_t>(i)];
            corner = {point(bx * kBlock + cx, by * kBlock + cy, bz * kBlock + cz),
                      distance[index(cx, cy, cz)]};
            inside_count += corner.distance < 0 ? 1 : 0;
          }
          if (inside_count == 0 || inside_count == 8) continue;
          for (const auto& t : kTetrahedra)
            add_tetrahedron(
                {&cube[static_cast<std::size_t>(t[0])], &cube[static_cast<std::size_t>(t[1])],
                 &cube[static_cast<std::size_t>(t[2])], &cube[static_cast<std::size_t>(t[3])]},
                vertices);
        }
  }
};

}  // namespace

Mesh make_mesh(const Shape& shape, double cell_mm) {
  const Box box = shape.bounds();
  const Grid grid{shape, box.low_mm, cell_mm};
  std::array<int, 3> blocks{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double side = box.high_mm[static_cast<int>(axis)] - box.low_mm[static_cast<int>(axis)];
    blocks[axis] = static_cast<int>(std::ceil(side / (cell_mm * Grid::kBlock)));
  }
  // One list a layer of blocks, joined in order: independent of the threads' timing.
  std::vector<std::vector<std::array<float, 3>>> layers(static_cast<std::size_t>(blocks[2]));
  tbb::parallel_for(0, blocks[2], [&](int bz) {
    for (int by = 0; by < blocks[1]; ++by)
      for (int bx = 0; bx < blocks[0]; ++bx)
        if (grid.may_hold_surface(bx, by, bz))
          grid.add_block(bx, by, bz, layers[static_cast<std::size_t>(bz)]);
  });
  Mesh mesh;
  for (const auto& layer : layers)
    mesh.vertices_mm.insert(mesh.vertices_mm.end(), layer.begin(), layer.end());
  return mesh;
}

}  // namespace hw_sim
