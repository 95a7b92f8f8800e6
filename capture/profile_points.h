// The scattering profiles of a few points, as in the paper's Figure 2, read back from a session.
#pragma once

#include <filesystem>
#include <vector>

#include "estimation/report/quicklook.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace capture {

// Four pixels with a valid map, spread over the face from top to bottom: their reflectance factor
// (camera black removed, the longest exposure that is not saturated, cosine and distance from the
// maps) under each column stripe of the method's period. Empty where there is no valid pixel, no
// such stripes, or no irradiance calibration.
estimation::Result<std::vector<estimation::ProfilePoint>> read_profile_points(
    const std::filesystem::path& session, const estimation::Manifest& manifest,
    const estimation::Maps& maps);

}  // namespace capture
