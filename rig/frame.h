// One frame as the camera delivered it: a move-only lease on a preallocated buffer.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "rig/clock.h"

namespace rig {

// Keeps the memory behind a frame alive; its destructor hands the buffer back to the camera's pool
// (from any thread). It may outlive the camera: the pool lives as long as its last lease.
class FrameLease {
 public:
  virtual ~FrameLease() = default;
};

struct Frame {
  std::span<const std::byte>
      pixels;  // row-major, unpadded; 8 bit or 16 bit little-endian, right-aligned
  int width_px = 0;
  int height_px = 0;
  std::string pixel_format;    // PFNC name, "BayerRG12"
  std::uint64_t block_id = 0;  // GVSP block id, unwrapped: 1, 2, 3, ... since the camera was armed
  CameraClock::time_point timestamp;  // start of exposure on the camera's clock
  HostTime received;
  // Chunk data; nullopt where the camera has no such chunk.
  std::optional<std::chrono::microseconds> exposure;
  std::optional<std::uint64_t>
      trigger_count;  // pulses on the trigger line since arming, this one included
  std::optional<int> sequencer_set;
  // The trigger line's level when the exposure began; where edges of both kinds are triggers.
  std::optional<bool> is_line_high;
  std::unique_ptr<FrameLease> lease;
};

}  // namespace rig
