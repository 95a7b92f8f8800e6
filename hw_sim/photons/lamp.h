// The projector's light on its first way into the skin: through the curved, refracting surface to
// a point below it, not yet scattered.
#pragma once

#include <optional>

#include "hw_sim/photons/matter.h"
#include "hw_sim/photons/shape_grid.h"

namespace hw_sim {

// A point that shines alike in all directions.
struct Lamp {
  estimation::Vec3 center_mm;
  double intensity_mm2 = 0;  // irradiance times squared distance
};

struct UnscatteredLight {
  estimation::Vec3 entry_mm;   // where it came through the surface
  estimation::Vec3 normal;     // of the surface there
  estimation::Vec3 direction;  // in which it travels below it
  double length_mm = 0;        // from there
  // On a small area across the way, less what the matter on the way takes.
  double irradiance = 0;
};

// The light that reaches `point_mm` inside the shape, cast shadows apart. nullopt where the surface
// above is turned away. The area that a thin pencil lights follows from the surface's curvature.
std::optional<UnscatteredLight> light_at(const ShapeGrid& shape, const Lamp& lamp,
                                         const estimation::Vec3& point_mm);

}  // namespace hw_sim
