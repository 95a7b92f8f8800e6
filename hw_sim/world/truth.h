// The truth maps of a scene, as a perfect estimator would write them.
#pragma once

#include <array>
#include <filesystem>
#include <vector>

#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/seen_points.h"

namespace hw_sim {

// `received`: indirect irradiance [point][band] of the fully lit image; empty: none.
// Runs in the caller's TBB arena.
estimation::Result<void> write_truth(const std::filesystem::path& folder,
                                     const estimation::CameraInfo& camera, const SeenPoints& seen,
                                     const ProjectorLight& light,
                                     const std::vector<std::array<float, 3>>& received,
                                     ScatteringModel model, const TotalReflectance& reflectance_of);

}  // namespace hw_sim
