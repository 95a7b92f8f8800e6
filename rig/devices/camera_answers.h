// What a camera says of itself and of its frames, judged before anything is built on it. Knows no
// Aravis, so that tests/fuzz can say anything. Internal to the Aravis adapter.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "rig/fault.h"
#include "rig/frame.h"

namespace rig {

// A frame's chunks as GenICam gives them; nullopt where the camera has no such chunk.
struct ChunkAnswers {
  std::optional<double> exposure_us;
  std::optional<std::int64_t> trigger_count;  // since the counter was reset
  std::optional<std::int64_t> sequencer_set;
  std::optional<std::int64_t> line_status;  // a bit a line
};

// How to read them.
struct ChunkKey {
  std::int64_t trigger_base = 0;  // where the trigger counter stood when arming
  int line_bit = 0;               // the trigger line's, in line_status
};

// Puts them into the frame. Errors: kFrameMalformed for what no exposure, counter or set can be.
Result<void> take_chunks(const ChunkAnswers& answers, const ChunkKey& key, Frame& frame);

// Pulses since the counter stood at `base`; -1 if it cannot be one that counts up.
std::int64_t counted_since(std::int64_t base, std::int64_t count);

// Buffers of PayloadSize bytes must hold the image that is read from them. Errors: kProtocol.
Result<void> check_payload(std::size_t payload_bytes, std::size_t image_bytes);

}  // namespace rig
