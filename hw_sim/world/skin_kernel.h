// The light around the point where it enters skin, in space, for one material and one pair of
// directions. Oblique light comes out shifted, so it is not radial.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "hw_sim/world/angular_basis.h"
#include "hw_sim/world/dipole.h"

namespace hw_sim {

// How light meets and leaves a surface point.
struct LightPath {
  double incidence_rad = 0;     // to the normal
  double exit_rad = 0;          // to the normal
  double exit_azimuth_rad = 0;  // of the way out, from the way in projected on the surface
};

// Knots in r^2 sigma_s'^2, eight an octave, linear between: where a float's exponent and first
// three bits of mantissa change.
struct RadialKnots {
  static constexpr int kPerOctave = 8;
  static constexpr int kFirstExponent = -18;
  static constexpr int kOctaves = 34;
  static constexpr std::size_t kCount = kOctaves * kPerOctave + 1;

  struct Place {
    std::size_t knot = 0;  // below
    float fraction = 0;    // of the way to the next
  };
  static Place place_of(float r2);
  static double r2(std::size_t knot);
  // The integral of each knot's hat over the plane.
  static const std::array<double, kCount>& areas();
};

// K(r, a) = c0 + c1 cos a + s1 sin a + c2 cos 2a + s2 sin 2a around the point of entry, a from the
// projected way in: what an equally bright Lambertian surface would reflect, 1/mm^2, for light
// transmitted into the medium.
class SkinKernel {
 public:
  static constexpr int kTerms = 5;
  static constexpr std::size_t kKnots = RadialKnots::kCount;

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
  friend class SkinMaterial;
  float scale2_ = 1;  // sigma_s'^2
  double radius_mm_ = 0, total_ = 0;
  std::array<std::array<float, 8>, kKnots> knots_{};  // [knot][term], in 1/mm^2
};

// One material's share of a ScatterTable: its kernels for all directions.
class SkinMaterial {
 public:
  const Scattering& scattering() const { return scattering_; }
  SkinKernel kernel(const LightPath& path) const;

 private:
  friend class ScatterTable;
  static std::size_t index(std::size_t incidence, std::size_t exit, std::size_t knot) {
    return ((incidence * kAngleNodes + exit) * RadialKnots::kCount + knot) * kAngularStride;
  }
  Scattering scattering_;
  std::vector<float> orders_;  // [index()][order], of lengths in 1 / sigma_s'
};

}  // namespace hw_sim
