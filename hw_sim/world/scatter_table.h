// What the white Monte Carlo says of the light around the point where it enters, in space: the
// radiance that leaves, by place, by direction of incidence and exit, for any absorption. Oblique
// light comes out shifted, so nothing here is radial.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "hw_sim/world/dipole.h"

namespace hw_sim {

// How light meets and leaves a surface point.
struct LightPath {
  double incidence_rad = 0;     // to the normal
  double exit_rad = 0;          // to the normal
  double exit_azimuth_rad = 0;  // of the way out, from the way in projected on the surface
};

// K(r, a) = c0 + c1 cos a + s1 sin a + c2 cos 2a + s2 sin 2a around the point of entry, a from the
// projected way in: what an equally bright Lambertian surface would reflect, 1/mm^2, for light
// transmitted into the medium. Knots in r^2, eight an octave, linear between.
class SkinKernel {
 public:
  static constexpr int kTerms = 5;
  static constexpr int kKnotsPerOctave = 8;
  static constexpr int kFirstExponent = -18;  // of r^2 sigma_s'^2
  static constexpr int kOctaves = 34;
  static constexpr std::size_t kKnots = kOctaves * kKnotsPerOctave + 1;

  // Beyond `radius_mm` at most 1e-4 of the total is left.
  double radius_mm() const { return radius_mm_; }
  double total() const { return total_; }

  // Light by rings around the point of entry, a knot each: what sums exactly where at() is steep.
  struct Ring {
    double radius_mm = 0;
    double area_mm2 = 0;
    std::array<double, kTerms> terms{};  // c0, c1, s1, c2, s2
  };
  Ring ring(std::size_t knot) const;

  // r^2 and the offset from the point of entry along (x) and across (y) the way in, mm.
  float at(float distance2_mm2, float x_mm, float y_mm) const;

 private:
  friend class ScatterTable;
  float scale2_ = 1;  // sigma_s'^2
  double radius_mm_ = 0, total_ = 0;
  std::array<std::array<float, 8>, kKnots> knots_{};  // [knot][term], in 1/mm^2
};

// Immutable once made, so thread-safe.
class ScatterTable {
 public:
  // Walks the photons in the caller's TBB arena; the same numbers for any number of threads. About
  // 10 us a photon and core; `photons_per_angle` 1e6 puts reflectances within 0.1%.
  static ScatterTable make(int photons_per_angle, std::uint64_t seed,
                           const std::function<void(double done_frac)>& progress);
  // The same from `folder` where an earlier make() left it; an unreadable file is made again.
  static ScatterTable cached(const std::filesystem::path& folder, int photons_per_angle,
                             std::uint64_t seed,
                             const std::function<void(double done_frac)>& progress);

  SkinKernel kernel(const Scattering& scattering, const LightPath& path) const;
  // Of light transmitted at normal incidence, into all directions: R_d.
  double total_reflectance(const Scattering& scattering) const;

  // sigma_a / sigma_s' that the table holds.
  static constexpr double kLeastRatio = 8e-4, kGreatestRatio = 4;

 private:
  static constexpr std::size_t kRatios = 22;
  static constexpr std::array<double, 5> kIncidences_rad = {0, 0.35, 0.7, 1.05, 1.35};
  static constexpr std::array<double, 5> kExits_rad = {0, 0.35, 0.7, 1.05, 1.35};
  // Of place cos(m a) with exit cos(n b): 0..8 for m, n = 0..2; of sines: 9..12 for m, n = 1..2.
  static constexpr std::size_t kMoments = 13, kStride = 16;

  struct Strand;
  static std::size_t index(std::size_t incidence, std::size_t exit, std::size_t ratio,
                           std::size_t knot) {
    return (((incidence * kExits_rad.size() + exit) * kRatios + ratio) * SkinKernel::kKnots +
            knot) *
           kStride;
  }
  struct Corner {
    std::size_t at;
    double weight;
  };
  static std::array<Corner, 4> ratio_corners(double ratio);
  static std::array<Corner, 2> angle_corners(const std::array<double, 5>& nodes, double angle_rad);
  bool load(const std::filesystem::path& file, std::uint64_t key);
  void save(const std::filesystem::path& file, std::uint64_t key) const;
  std::uint64_t checksum() const;

  std::vector<float> moments_;            // radiance per area, [index()][moment]
  std::array<double, kRatios> totals_{};  // at normal incidence, into the hemisphere
};

}  // namespace hw_sim
