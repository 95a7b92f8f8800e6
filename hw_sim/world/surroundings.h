// What surrounds a seen point, as its skin weighs it: the light that enters there comes out here.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "hw_sim/world/dipole.h"
#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/skin_around.h"
#include "hw_sim/world/split_picture.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {

inline constexpr double kTailFrac = 1e-4;  // of R_d beyond the radius that is summed

inline estimation::Vec3 point_of(const SeenSample& sample) {
  return {static_cast<double>(sample.point_mm[0]), static_cast<double>(sample.point_mm[1]),
          static_cast<double>(sample.point_mm[2])};
}

// The paper's dipole, smooth enough for the lattice alone.
struct DipoleAround {
  const KernelTable& kernel;
  float radius2_mm2() const { return kernel.radius2_mm2(); }
  float at(float distance2, float, float, float) const { return kernel.at(distance2); }
  static std::vector<SkinAround::Patch> near_patches() { return {}; }
};

// A sphere around a point as the projector sees it, px.
struct Disc {
  double row_px = 0, col_px = 0, radius_px = 0;
};

// The lattice points of `lattice` within `rect` (projector pixels, grown by `margin` points) and
// within the kernel's radius, which `disc` holds: calls use(lattice row, lattice col, index,
// weight).
template <typename Around, typename Use>
void for_each_lit(const LightLattice& lattice, const Disc& disc, const SplitPicture::Rect& rect,
                  int margin, const std::array<float, 3>& point, const Around& kernel,
                  const Use& use) {
  const int n = lattice.per_px;
  const int row_begin = std::max(rect.row_begin * n - margin, 0);
  const int row_end = std::min(rect.row_end * n + margin, lattice.height);
  const int col_begin = std::max(rect.col_begin * n - margin, 0);
  const int col_end = std::min(rect.col_end * n + margin, lattice.width);
  const float radius2 = kernel.radius2_mm2();
  for (int row = row_begin; row < row_end; ++row) {
    const std::size_t base =
        static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width);
    const double off_px = (row + 0.5) / n - 0.5 - disc.row_px;
    const double half_px =
        std::sqrt(std::max(0.0, disc.radius_px * disc.radius_px - off_px * off_px));
    const int chord_begin = static_cast<int>((disc.col_px - half_px) * n) - 1;
    const int chord_end = static_cast<int>((disc.col_px + half_px + 1) * n) + 1;
    for (int col = std::max(col_begin, chord_begin); col < std::min(col_end, chord_end); ++col) {
      const std::size_t i = base + static_cast<std::size_t>(col);
      const float dx = lattice.x_mm[i] - point[0];
      const float dy = lattice.y_mm[i] - point[1];
      const float dz = lattice.z_mm[i] - point[2];
      const float distance2 = dx * dx + dy * dy + dz * dz;
      if (distance2 < radius2)
        use(row, col, i, lattice.flux_mm2[i] * kernel.at(distance2, dx, dy, dz));
    }
  }
}

// One task's.
struct Surroundings {
  const ProjectorLight& light;
  const ScatterTable* table;  // null: the paper's dipole
  // Neighbours mostly share their material: keep its dipole, or of Monte Carlo the latest few, as
  // the bands of a Bayer pattern take turns.
  Scattering scattering = {};
  KernelTable kernel = {};
  static constexpr std::size_t kMaterials = 4;
  std::vector<SkinMaterial> materials = {};
  std::size_t next_material = 0;
  double radius_mm = 0;

  const SkinMaterial& material_of(const Scattering& wanted) {
    const auto found =
        std::find_if(materials.begin(), materials.end(),
                     [&](const SkinMaterial& each) { return each.scattering() == wanted; });
    if (found != materials.end()) return *found;
    if (materials.size() < kMaterials) return materials.emplace_back(table->material(wanted));
    SkinMaterial& oldest = materials[next_material++ % kMaterials];
    oldest = table->material(wanted);
    return oldest;
  }

  // Calls use(around) with what surrounds the sample; sets radius_mm.
  template <typename Use>
  void around(const SeenSample& sample, const Use& use) {
    if (table != nullptr) {
      const SkinAround skin(material_of(sample.scattering), sample, light);
      radius_mm = skin.radius_mm();
      use(skin);
      return;
    }
    if (!(sample.scattering == scattering)) {
      scattering = sample.scattering;
      const Dipole dipole(scattering);
      radius_mm = dipole.radius_with_tail_mm(kTailFrac);
      kernel = KernelTable(dipole, radius_mm);
    }
    use(DipoleAround{kernel});
  }

  // What the projector sees of the sphere of the kernel's radius; one more pixel for the lens's
  // distortion and perspective. Radius 0: behind the projector.
  Disc disc_of(const SeenSample& sample) const {
    const estimation::Vec3 point = point_of(sample);
    const ProjectedPoint center = light.projector().project(point);
    if (!center.is_in_front) return {};
    const double distance_mm = cv::norm(point - light.projector().center_mm());
    const double radius_px =
        light.projector().focal_px() * radius_mm / std::max(distance_mm - radius_mm, 1.0) * 1.02 +
        1;
    return {center.row_px, center.col_px, radius_px};
  }

  SplitPicture::Rect reach_of(const Disc& disc) const {
    if (disc.radius_px <= 0) return {};
    const auto clamped = [](double value, int limit) {
      return static_cast<int>(std::clamp(value, 0.0, static_cast<double>(limit)));
    };
    return {clamped(std::floor(disc.row_px - disc.radius_px), light.height_px()),
            clamped(std::ceil(disc.row_px + disc.radius_px) + 1, light.height_px()),
            clamped(std::floor(disc.col_px - disc.radius_px), light.width_px()),
            clamped(std::ceil(disc.col_px + disc.radius_px) + 1, light.width_px())};
  }
};

}  // namespace hw_sim
