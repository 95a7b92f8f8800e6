// Pictures for a first look at a session: the maps in false colour, geometry, validity, a few
// frames, and the profiles of some points as in the paper's Figure 2.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/profile/profile_point.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace estimation {

// A raw frame to show, as read_frame returns it.
struct QuicklookFrame {
  std::string name;   // of the file, without ending: "frame_stripes"
  std::string title;  // "stripes column 40/8 shift 0, 16.7 ms"
  ImageView<const std::uint16_t> dn;
};

// Writes PNG files into `folder` (made if absent), whole or not at all; what `maps` does not hold
// is left out, and removed if an earlier run left it there. Returns the files written: sigma_a.png,
// sigma_s_prime.png, translucency.png, diffuse_reflectance.png, indirect.png, normal.png,
// depth.png, validity.png, profiles.png (of the first four points) and one a frame.
Result<std::vector<std::filesystem::path>> write_quicklook(const std::filesystem::path& folder,
                                                           const Maps& maps,
                                                           const CameraInfo& camera,
                                                           std::span<const QuicklookFrame> frames,
                                                           std::span<const ProfilePoint> profiles);

}  // namespace estimation
