// The scattering profiles of a few points, as in the paper's Figure 2: what was measured there, and
// the curves that the maps' values stand for.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct ProfileSample {
  double shift_px = 0;     // of the stripes, projector px
  double reflectance = 0;  // reflectance factor r: 1 is a perfect reflector under full light
  bool operator==(const ProfileSample&) const = default;
};

// One band of a point; in a Bayer mosaic a site of its own beside the point.
struct ProfileBand {
  int row = 0, col = 0;
  double peak_px = 0;                        // the shift that centres a stripe on the site
  double diffuse_reflectance = 0;            // R_d
  double translucency_mm = 0;                // l_d
  std::vector<ProfileSample> measured = {};  // by rising shift, each once
  std::vector<ProfileSample> matched = {};   // the fitted curve over a whole period, or empty
  bool operator==(const ProfileBand&) const = default;
};

struct ProfilePoint {
  int row = 0, col = 0;
  double period_px = 40;                  // of the stripes, projector px
  std::array<ProfileBand, 3> bands = {};  // mono uses the first
  bool operator==(const ProfilePoint&) const = default;
};

// Four points spread over the subject: of each quadrant of the bounding box of the valid pixels
// (no error in any band), the valid pixel nearest to the quadrant's centre; among equals the first
// in image order. Fewer if they coincide, none if no pixel is valid. Of the bands only the places
// are set: the nearest site of the band that is valid itself.
//   validity  [band] as in Maps, completed between a mosaic's sites
std::vector<ProfilePoint> choose_profile_points(
    const CameraInfo& camera, const std::array<Image<std::uint32_t>, 3>& validity);

}  // namespace estimation
