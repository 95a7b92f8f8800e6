// One camera sample's surroundings as light transport sums them when skin scatters as Monte Carlo
// says: the kernel is singular where light enters, so what is near is integrated in polar
// coordinates over the tangent plane, on the quadric
// that fits the surface there, and only the smooth rest over the projector's lattice of rays.
#pragma once

#include <vector>

#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/skin_kernel.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {

class SkinAround {
 public:
  // material: the sample's
  SkinAround(const SkinMaterial& material, const SeenSample& sample, const ProjectorLight& light);

  float radius2_mm2() const { return radius2_; }
  double radius_mm() const { return kernel_.radius_mm(); }

  // What light entering at an offset (dx, dy, dz; its square distance2) adds, 1/mm^2, less the near
  // part.
  float at(float distance2, float dx, float dy, float dz) const;

  // The near part: light that enters within a small patch adds `weight` if its projector pixels are
  // lit; in projector px. Patches in shadow are left out.
  struct Patch {
    double row_px = 0, col_px = 0;                // centre
    double row_extent_px = 0, col_extent_px = 0;  // full widths
    double weight = 0;
  };
  std::vector<Patch> near_patches() const;

 private:
  struct Slopes;
  Slopes slopes() const;
  // Second derivatives of the surface's height over the tangent plane, 1/mm, from the lattice.
  struct Bend {
    double along = 0, mixed = 0, across = 0;
  };
  Bend bend() const;
  // Where light meets the surface over a place of the tangent plane, and how much beside the
  // sample's own irradiance meets a unit of the plane there.
  struct Place {
    double row_px = 0, col_px = 0;
    double light = 0;
  };
  Place place_at(double along_mm, double across_mm, const Bend& bend) const;
  bool is_lit(double row_px, double col_px) const;
  // Terms times area of knots from the first radius (0: a core) to the last.
  void add_ring(const std::array<double, SkinKernel::kTerms>& light, double first_mm,
                double last_mm, const Slopes& slopes, const Bend& bend,
                std::vector<Patch>& patches) const;

  const ProjectorLight& light_;
  // along: the way in, projected on the surface
  estimation::Vec3 point_, normal_, along_, across_;
  SkinKernel kernel_;
  double irradiance_ = 0;   // of the sample's own place under white light
  float transmission_ = 0;  // of the boundary, for light from the projector
  float radius2_ = 0;
  double near_mm_ = 0, far_mm_ = 0;  // the near part fades out from the one to the other
};

}  // namespace hw_sim
