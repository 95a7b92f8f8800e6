// What photons meet under the surface: absorption, scattering and its anisotropy, by place.
#pragma once

#include <array>
#include <vector>

#include "hw_sim/photons/shape_grid.h"
#include "hw_sim/world/scene.h"

namespace hw_sim {

struct VolumeOptics {
  double sigma_a_per_mm = 0;
  double sigma_s_per_mm = 0;  // not reduced
  double anisotropy = 0;      // Henyey and Greenstein's g
  double sigma_t_per_mm() const { return sigma_a_per_mm + sigma_s_per_mm; }
};

// With the anisotropy that the simulator's white Monte Carlo has.
VolumeOptics volume_optics(const Scattering& scattering);

// Immutable, so thread-safe.
class Matter {
 public:
  virtual ~Matter() = default;
  virtual VolumeOptics at(const estimation::Vec3& point_mm) const = 0;
  // No place has a larger sigma_t.
  virtual double greatest_sigma_t_per_mm() const = 0;
};

class UniformMatter final : public Matter {
 public:
  explicit UniformMatter(const VolumeOptics& optics) : optics_(optics) {}
  VolumeOptics at(const estimation::Vec3& /*point_mm*/) const override { return optics_; }
  double greatest_sigma_t_per_mm() const override { return optics_.sigma_t_per_mm(); }

 private:
  VolumeOptics optics_;
};

// One band of a scene's skin, which goes on inward along the normal: a point has the material of
// the place on the surface above it. Sampled on the shape's grid, linear between; outside its
// box as at the box's nearest place.
class SkinMatter final : public Matter {
 public:
  // All three bands. Runs in the caller's TBB arena.
  static std::array<SkinMatter, 3> bands_of(const SkinMap& skin, const ShapeGrid& shape);

  VolumeOptics at(const estimation::Vec3& point_mm) const override;
  double greatest_sigma_t_per_mm() const override { return greatest_sigma_t_per_mm_; }

 private:
  explicit SkinMatter(const GridFrame& frame) : frame_(frame), nodes_(frame.node_count()) {}

  GridFrame frame_;
  std::vector<std::array<float, 2>> nodes_;  // sigma_a, sigma_s'
  double greatest_sigma_t_per_mm_ = 0;
};

}  // namespace hw_sim
