// Opening a GigE Vision camera for one rig file: who it is, and every setting written and read
// back. Internal to the Aravis adapter.
#pragma once

#include <optional>
#include <string>

#include "rig/camera.h"
#include "rig/devices/aravis_camera.h"
#include "rig/devices/aravis_chunks.h"
#include "rig/devices/aravis_features.h"
#include "rig/devices/aravis_look.h"
#include "rig/devices/aravis_stream.h"

namespace rig {

// What a camera is and gives, once set up.
struct AravisSetup {
  CameraIdentity identity;
  CameraLook look;
  FrameFormat format;
  ChunkFeatures chunks;
  int packet_size_bytes = 0;
  bool has_trigger_counter = false;
};

// Errors: those of AravisCamera::open(), but for a camera that does not answer.
// `past`: of the camera that this must be, if it was open before.
Result<AravisSetup> set_up(_ArvCamera* camera, const CameraSettings& settings,
                           const std::optional<CameraPast>& past);

// "the camera at ADDRESS", for messages.
std::string name_of(const CameraSettings& settings);

}  // namespace rig
