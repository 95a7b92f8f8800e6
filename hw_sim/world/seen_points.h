// What each camera pixel sees of the surface: one ray through its centre.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world/optics.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/surface.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {

struct SeenPoint {
  std::int32_t row = 0, col = 0;
  estimation::Vec3 point_mm;
  estimation::Vec3 normal;
  Skin skin;
  double cos_projector = 0;  // negative: turned away
  double cos_camera = 0;
  double pixel_mm = 0;  // a camera pixel's side at that distance
  bool is_lit = false;  // the projector sees it: inside its picture, not in a shadow
};

struct SeenPoints {
  std::vector<SeenPoint> points;     // in pixel order
  std::vector<SeenSample> samples;   // of the frame, in sample order
  std::vector<std::uint8_t> bands;   // of each sample's light: 0 R, 1 G, 2 B; mono 1, as green
  std::vector<std::int32_t> owners;  // index into points of each sample
};

// Of a camera band's light `crosstalk_frac` is that of each other band. Runs in the caller's TBB
// arena.
SeenPoints find_seen_points(const estimation::CameraInfo& camera, const Pinhole& eye,
                            const Pinhole& lamp, int lamp_height_px, int lamp_width_px,
                            const Surface& surface, const SkinMap& skin, double crosstalk_frac);

}  // namespace hw_sim
