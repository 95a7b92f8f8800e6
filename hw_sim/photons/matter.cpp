#include "hw_sim/photons/matter.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

using estimation::Vec3;

VolumeOptics volume_optics(const Scattering& scattering) {
  return {scattering.sigma_a_per_mm, scattering.sigma_s_prime_per_mm / (1 - kSkinAnisotropy),
          kSkinAnisotropy};
}

namespace {

VolumeOptics optics_of(const std::array<float, 2>& node) {
  return volume_optics({static_cast<double>(node[0]), static_cast<double>(node[1])});
}

}  // namespace

std::array<SkinMatter, 3> SkinMatter::bands_of(const SkinMap& skin, const ShapeGrid& shape) {
  const GridFrame& frame = shape.frame();
  std::array<SkinMatter, 3> bands = {SkinMatter(frame), SkinMatter(frame), SkinMatter(frame)};
  tbb::parallel_for(0, frame.layer_count(), [&](int layer) {
    const std::size_t begin = static_cast<std::size_t>(layer) * frame.nodes_per_layer();
    for (std::size_t node = begin; node < begin + frame.nodes_per_layer(); ++node) {
      const Material material = skin.at(shape.on_surface(frame.node_mm(node))).material;
      for (std::size_t band = 0; band < 3; ++band)
        bands[band].nodes_[node] = {static_cast<float>(material.bands[band].sigma_a_per_mm),
                                    static_cast<float>(material.bands[band].sigma_s_prime_per_mm)};
    }
  });
  for (SkinMatter& band : bands)
    for (const std::array<float, 2>& node : band.nodes_)
      band.greatest_sigma_t_per_mm_ =
          std::max(band.greatest_sigma_t_per_mm_, optics_of(node).sigma_t_per_mm());
  return bands;
}

VolumeOptics SkinMatter::at(const Vec3& point_mm) const {
  GridFrame::Cell cell;
  if (!frame_.locate(point_mm, cell)) cell = frame_.nearest(point_mm);
  return optics_of(frame_.between(cell, nodes_));
}

}  // namespace hw_sim
