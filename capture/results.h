// Storing what the estimator found, live or from disk: maps, and pictures for a first look.
#pragma once

#include <filesystem>
#include <vector>

#include "estimation/estimator.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// Writes the maps and the surface as a mesh (surface.ply) into `maps_folder` and, beside a few
// frames read back from `session`, their pictures into `report_folder` (none if empty). Returns the
// pictures.
estimation::Result<std::vector<std::filesystem::path>> write_results(
    const estimation::SessionEstimate& estimate, const estimation::Manifest& manifest,
    const std::filesystem::path& session, const std::filesystem::path& maps_folder,
    const std::filesystem::path& report_folder);

}  // namespace capture
