// How far the head moved in space between two showings of a striped pattern, by the surface that
// the capture found: no distance is assumed, and motion sideways counts, too.
#pragma once

#include <cstdint>

#include "estimation/base/image.h"
#include "estimation/base/linear.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace estimation {

struct SurfaceMotion {
  Vec3 translation_mm{0, 0, 0};  // camera coordinates, from the first showing to the second
  Vec3 sd_mm{0, 0, 0};           // from how much parts of the surface contradict each other
  int cell_count = 0;            // that were compared
};

// Light that moves over a rigid surface: where it has moved by t, the ray of a pixel meets it at
// another depth, by n.t / n.ray, and there at another place of the pattern; its brightness follows
// the picture's own slope along the pattern. Linear in t, so for stripes that moved by less than
// their width; the skin's own picture is taken to stay. Gain and ambient light are fitted along.
// `axis`: along which the pattern varies; `period_px` as for measure_change(). `maps` has position,
// normal and correspondence. Errors: kInvalid for sizes that differ; kInsufficient where too little
// is lit and known, or the surface cannot tell three directions apart, as a plane cannot.
Result<SurfaceMotion> measure_surface_motion(const CameraInfo& camera,
                                             const Calibration& calibration, Axis axis,
                                             double period_px, const Maps& maps,
                                             ImageView<const std::uint16_t> first,
                                             ImageView<const std::uint16_t> second);

}  // namespace estimation
