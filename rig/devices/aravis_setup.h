// Opening a GigE Vision camera for one rig file: who it is, and every setting written and read
// back. Internal to the Aravis adapter.
#pragma once

#include <string>

#include "rig/camera.h"
#include "rig/devices/aravis_chunks.h"
#include "rig/devices/aravis_features.h"
#include "rig/devices/aravis_stream.h"

namespace rig {

// What a camera is and gives, once set up.
struct AravisSetup {
  CameraIdentity identity;
  FrameFormat format;
  ChunkFeatures chunks;
  int packet_size_bytes = 0;
  bool has_trigger_counter = false;
};

// Errors: those of AravisCamera::open(), but for a camera that does not answer.
Result<AravisSetup> set_up(_ArvCamera* camera, const CameraSettings& settings);

// "the camera at ADDRESS", for messages.
std::string name_of(const CameraSettings& settings);

}  // namespace rig
