#include "hw_sim/world/projector_light.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstddef>
#include <optional>

namespace hw_sim {

using estimation::Vec3;

ProjectorLight::ProjectorLight(const Surface& surface, const Pinhole& projector, int height_px,
                               int width_px, double reference_distance_mm)
    : surface_(surface),
      projector_(projector),
      height_px_(height_px),
      width_px_(width_px),
      reference_distance_mm_(reference_distance_mm) {}

const LightLattice& ProjectorLight::coarse() const {
  // Isolated: a thread that waits for its rays must not pick up work that waits for this flag.
  std::call_once(coarse_once_, [&] { tbb::this_task_arena::isolate([&] { coarse_ = cast(1); }); });
  return coarse_;
}

const LightLattice& ProjectorLight::fine() const {
  std::call_once(fine_once_, [&] { tbb::this_task_arena::isolate([&] { fine_ = cast(2); }); });
  return fine_;
}

LightLattice ProjectorLight::cast(int per_px) const {
  constexpr float kFarAway = 1e6F;
  LightLattice lattice;
  lattice.per_px = per_px;
  lattice.height = height_px_ * per_px;
  lattice.width = width_px_ * per_px;
  const auto count =
      static_cast<std::size_t>(lattice.height) * static_cast<std::size_t>(lattice.width);
  for (auto* axis : {&lattice.x_mm, &lattice.y_mm, &lattice.z_mm}) axis->assign(count, kFarAway);
  lattice.flux_mm2.assign(count, 0);
  lattice.triangle.assign(count, -1);
  const double spacing = 1.0 / per_px;
  const double area_scale = reference_distance_mm_ * reference_distance_mm_;
  tbb::parallel_for(0, lattice.height, [&](int row) {
    for (int col = 0; col < lattice.width; ++col) {
      const double col_px = (col + 0.5) * spacing - 0.5, row_px = (row + 0.5) * spacing - 0.5;
      const std::optional<Hit> hit = surface_.first_hit(projector_.ray(col_px, row_px));
      if (!hit) continue;
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width) +
                     static_cast<std::size_t>(col);
      lattice.x_mm[i] = static_cast<float>(hit->point_mm[0]);
      lattice.y_mm[i] = static_cast<float>(hit->point_mm[1]);
      lattice.z_mm[i] = static_cast<float>(hit->point_mm[2]);
      lattice.flux_mm2[i] =
          static_cast<float>(area_scale * projector_.solid_angle_sr(col_px, row_px, spacing));
      lattice.triangle[i] = hit->triangle;
    }
  });
  return lattice;
}

std::vector<float> light_on_lattice(const LightLattice& lattice,
                                    estimation::ImageView<const float> brightness) {
  const int height = lattice.height, width = lattice.width, per_px = lattice.per_px;
  const auto size = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  std::vector<float> along_rows(size), light(size);
  const auto index = [&](int row, int col) {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
           static_cast<std::size_t>(col);
  };
  tbb::parallel_for(0, height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      float sum = 0;
      for (int tap = -2; tap <= 2; ++tap) {
        const int from = std::clamp(col + tap, 0, width - 1);
        sum += kSquareTaps[tap + 2] * brightness.at(row / per_px, from / per_px);
      }
      along_rows[index(row, col)] = sum;
    }
  });
  tbb::parallel_for(0, height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      float sum = 0;
      for (int tap = -2; tap <= 2; ++tap)
        sum += kSquareTaps[tap + 2] * along_rows[index(std::clamp(row + tap, 0, height - 1), col)];
      light[index(row, col)] = sum;
    }
  });
  return light;
}

}  // namespace hw_sim
