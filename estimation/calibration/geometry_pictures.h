// The report of a geometry calibration: a text, and pictures as PNG files.
#pragma once

#include <filesystem>
#include <string>

#include "estimation/calibration/geometry_check.h"
#include "estimation/calibration/geometry_fit.h"
#include "estimation/session/error.h"

namespace estimation {

// Tables for people: rms of each pose, parameters with standard deviations, coverage.
std::string describe_geometry(const GeometryFit& fit, const GeometryCheck& check);

// Writes pose_errors.png (rms of each pose in both devices), camera_coverage.png and
// projector_coverage.png (corners with their residuals, much enlarged, on the picture's area) into
// `folder`, made if absent.
Result<void> draw_geometry(const std::filesystem::path& folder, const GeometryFit& fit,
                           const CameraInfo& camera, const ProjectorInfo& projector);

}  // namespace estimation
