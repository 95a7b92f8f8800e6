// How one trigger becomes one exposure of its bracket: the camera's sequencer, or the pulse's
// width. Internal to the Aravis adapter.
#pragma once

#include <chrono>
#include <vector>

#include "rig/camera.h"
#include "rig/devices/aravis_features.h"

namespace rig {

// Writes them and reads them back. `has_exposure_chunk`: the frames say how long they were exposed.
// Errors: kOutOfRange; kUnsupported (a sequencer without that chunk); those of AravisFeatures.
Result<void> set_exposures(const AravisFeatures& features, const CameraSettings& settings,
                           bool has_exposure_chunk,
                           const std::vector<std::chrono::microseconds>& exposures);

}  // namespace rig
