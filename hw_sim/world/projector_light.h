// The projector's light where it meets the surface, as points with a flux.
#pragma once

#include <cstdint>
#include <mutex>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/world/optics.h"
#include "hw_sim/world/surface.h"

namespace hw_sim {

// `per_px` x `per_px` rays a projector pixel, structure of arrays, row-major. Cosine, distance and
// cast shadow are in it exactly: flux goes with the ray's solid angle to whatever the ray hits.
struct LightLattice {
  int per_px = 1;
  int height = 0;  // lattice points
  int width = 0;
  std::vector<float> x_mm, y_mm, z_mm;  // far away where the ray misses
  std::vector<float> flux_mm2;          // irradiance times area; 0 where the ray misses
  std::vector<std::int32_t> triangle;   // -1 where the ray misses
};

// Thread-safe: lattices are cast when first asked for, in the caller's TBB arena.
class ProjectorLight {
 public:
  // Irradiance is 1 at `reference_distance_mm` from the projector on a surface that faces it.
  ProjectorLight(const Surface& surface, const Pinhole& projector, int height_px, int width_px,
                 double reference_distance_mm);

  const Pinhole& projector() const { return projector_; }
  int height_px() const { return height_px_; }
  int width_px() const { return width_px_; }
  double reference_distance_mm() const { return reference_distance_mm_; }
  const LightLattice& coarse() const;  // one ray a pixel
  const LightLattice& fine() const;    // two by two

 private:
  LightLattice cast(int per_px) const;

  const Surface& surface_;
  Pinhole projector_;
  int height_px_, width_px_;
  double reference_distance_mm_;
  mutable std::once_flag coarse_once_, fine_once_;
  mutable LightLattice coarse_, fine_;  // written once, under their flags
};

// A picture as light on a lattice: every pixel is a lit square, but a lattice has points, so the
// picture takes the filter that makes a sum over points the integral over squares (to fourth order
// in the spacing). [lattice height][lattice width], 0..1.
std::vector<float> light_on_lattice(const LightLattice& lattice,
                                    estimation::ImageView<const float> brightness);

// The same filter for a response that was summed over points: taps for offsets -2 ... 2.
inline constexpr float kSquareTaps[5] = {-17.0F / 5760, 1.0F / 24 + 17.0F / 1440,
                                         1 - 1.0F / 12 - 17.0F / 960, 1.0F / 24 + 17.0F / 1440,
                                         -17.0F / 5760};

}  // namespace hw_sim
