// What of a camera the rig file does not say, but every pixel depends on: how it amplifies, bins
// and mirrors. Whoever set the camera up decides on it, and it may not survive a power cut.
// Internal to the Aravis adapter.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "rig/devices/aravis_features.h"

namespace rig {

// Names of features and their values, as text.
using CameraLook = std::vector<std::pair<std::string, std::string>>;

// Those that this camera has. Errors: those of AravisFeatures.
Result<CameraLook> read_look(const AravisFeatures& features);

// Writes what differs, and reads it back.
Result<void> restore_look(const AravisFeatures& features, const CameraLook& look);

}  // namespace rig
