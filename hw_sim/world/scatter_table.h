// What the white Monte Carlo says of the light around the point where it enters, in space: the
// radiance that leaves, by place, by direction of incidence and exit, for any absorption.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "hw_sim/world/angular_basis.h"
#include "hw_sim/world/dipole.h"
#include "hw_sim/world/skin_kernel.h"

namespace hw_sim {

// Immutable once made, so thread-safe.
class ScatterTable {
 public:
  // Walks the photons in the caller's TBB arena; the same numbers for any number of threads. About
  // 3 us a photon and core, kAngleNodes times `photons_per_angle`. Totals have no photons' noise;
  // at 3e6 the first harmonic of stripes 12 mm apart has 0.3% for one direction of exit on a cheek,
  // the fourth 1%; of all exits 0.1 and 0.2%.
  static ScatterTable make(int photons_per_angle, std::uint64_t seed,
                           const std::function<void(double done_frac)>& progress);
  // The same from `folder` where an earlier make() left it; an unreadable file is made again.
  static ScatterTable cached(const std::filesystem::path& folder, int photons_per_angle,
                             std::uint64_t seed,
                             const std::function<void(double done_frac)>& progress);

  // Ten times a kernel's cost: neighbours share it.
  SkinMaterial material(const Scattering& scattering) const;
  SkinKernel kernel(const Scattering& scattering, const LightPath& path) const {
    return material(scattering).kernel(path);
  }
  // Of light transmitted at normal incidence, into all directions: R_d.
  double total_reflectance(const Scattering& scattering) const;

  // sigma_a / sigma_s' that the table holds.
  static constexpr double kLeastRatio = 8e-4, kGreatestRatio = 4;

 private:
  static constexpr std::size_t kRatios = 22;

  struct Strand;
  struct Corner {
    std::size_t at;
    double weight;
  };
  static std::array<Corner, 4> ratio_corners(double ratio);
  static std::size_t index(std::size_t ratio, std::size_t incidence, std::size_t exit,
                           std::size_t knot) {
    return ratio * kRatioSize + SkinMaterial::index(incidence, exit, knot);
  }
  static constexpr std::size_t kRatioSize =
      kAngleNodes * kAngleNodes * RadialKnots::kCount * kAngularStride;
  void take(const std::vector<Strand>& strands, std::size_t incidence, double photons);
  void make_reciprocal();
  void smooth_over_radius();
  using Noise = std::vector<double>;  // variance by place: [knot][ratio]
  void set_totals(const Noise& noise);
  bool load(const std::filesystem::path& file, std::uint64_t key);
  void save(const std::filesystem::path& file, std::uint64_t key) const;
  std::uint64_t checksum() const;

  std::vector<float> orders_;             // g_mk per area, [index()][order]
  std::array<double, kRatios> totals_{};  // at normal incidence, into the hemisphere
};

}  // namespace hw_sim
