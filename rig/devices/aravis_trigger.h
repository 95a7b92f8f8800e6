// What triggers an exposure of a camera, and what counts the triggers. Internal to the Aravis
// adapter.
#pragma once

#include "rig/camera.h"
#include "rig/devices/aravis_features.h"
#include "rig/devices/aravis_setup.h"

namespace rig {

// After the chunks were switched on; takes back the trigger count's where it counts something else,
// and notes what the camera does without. Errors: kUnsupported (with the remedy), kOutOfRange, and
// those of AravisFeatures.
Result<void> set_trigger(const AravisFeatures& features, const CameraSettings& settings,
                         AravisSetup& setup);

}  // namespace rig
