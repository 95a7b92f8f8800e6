// What a camera says with each frame: which chunks it has, by the names that cameras give them, and
// what they hold. Internal to the Aravis adapter.
#pragma once

#include <cstdint>
#include <string>

#include "rig/camera.h"
#include "rig/devices/aravis_features.h"
#include "rig/devices/aravis_objects.h"
#include "rig/frame.h"

struct _ArvBuffer;

namespace rig {

// Which chunks this camera sends; empty where it has none.
struct ChunkFeatures {
  std::string exposure, trigger_count, sequencer_set, line_status;
  int line_bit = 0;  // the trigger line's, in line_status
  bool is_active() const;
};

// Switches on those that are wanted under these settings. Chunks are welcome but optional: a camera
// without them gives frames without those values. Errors: those of AravisFeatures.
Result<ChunkFeatures> enable_chunks(const AravisFeatures& features, const CameraSettings& settings);

// Used by one thread.
class ChunkReader {
 public:
  ChunkReader(GObjectPtr<_ArvChunkParser> parser, ChunkFeatures chunks)
      : parser_(std::move(parser)), chunks_(std::move(chunks)) {}

  bool is_active() const { return chunks_.is_active(); }
  // `trigger_base`: the camera's trigger counter at arming. Errors: kFrameMalformed.
  Result<void> read(_ArvBuffer* buffer, std::int64_t trigger_base, Frame& frame) const;

 private:
  GObjectPtr<_ArvChunkParser> parser_;
  ChunkFeatures chunks_;
};

}  // namespace rig
