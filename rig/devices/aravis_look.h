// What of a camera the rig file does not say, but every pixel depends on: how it amplifies, bins
// and mirrors. Whoever set the camera up decides on it, and it may not survive a power cut.
// Internal to the Aravis adapter.
#pragma once

#include <optional>
#include <string>

#include "rig/devices/aravis_camera.h"
#include "rig/devices/aravis_features.h"

namespace rig {

// What this camera tells, under each entry of the selectors. Errors: kDeviceLost.
Result<CameraLook> read_look(const AravisFeatures& features);

// Both write what differs, as far as the camera takes it: look_difference() of what it then tells
// is the judge. Errors: kDeviceLost.
// Binning and mirroring: the formats and regions that can be had depend on them.
Result<void> restore_shape(const AravisFeatures& features, const CameraLook& was);
// Gains, black levels ...: in units of the pixel format.
Result<void> restore_levels(const AravisFeatures& features, const CameraLook& was);

// "Gain under GainSelector Red is 0 and was 7.39815", of the first that differs.
std::optional<std::string> look_difference(const CameraLook& was, const CameraLook& is);

}  // namespace rig
