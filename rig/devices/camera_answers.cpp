#include "rig/devices/camera_answers.h"

#include <chrono>
#include <cmath>
#include <limits>
#include <string>

namespace rig {
namespace {

// Ten times the rig file's longest.
constexpr double kLongestExposure_us = 100e6;
// Chunk data, and what a vendor pads with; more is no payload of this image.
constexpr std::size_t kMostExtraBytes = std::size_t{1} << 20;

tl::unexpected<Error> malformed(std::uint64_t block_id, const std::string& what) {
  return failure(Fault::kFrameMalformed, "block " + std::to_string(block_id) + " says " + what);
}

}  // namespace

std::int64_t counted_since(std::int64_t base, std::int64_t count) {
  if (base < 0 || count < base) return -1;
  return count - base;
}

Result<void> take_chunks(const ChunkAnswers& answers, const ChunkKey& key, Frame& frame) {
  if (answers.exposure_us) {
    const double exposure_us = *answers.exposure_us;
    if (!(exposure_us >= 0 && exposure_us <= kLongestExposure_us))
      return malformed(frame.block_id,
                       "that it was exposed for " + std::to_string(exposure_us) + " us");
    frame.exposure = std::chrono::microseconds(std::llround(exposure_us));
  }
  if (answers.trigger_count) {
    const std::int64_t count = counted_since(key.trigger_base, *answers.trigger_count);
    if (count < 0)
      return malformed(frame.block_id, "trigger count " + std::to_string(*answers.trigger_count) +
                                           ", which stood at " + std::to_string(key.trigger_base) +
                                           " when arming");
    frame.trigger_count = static_cast<std::uint64_t>(count);
  }
  if (answers.sequencer_set) {
    const std::int64_t set = *answers.sequencer_set;
    if (set < 0 || set > std::numeric_limits<int>::max())
      return malformed(frame.block_id, "sequencer set " + std::to_string(set));
    frame.sequencer_set = static_cast<int>(set);
  }
  if (answers.line_status) frame.is_line_high = (*answers.line_status >> key.line_bit & 1) != 0;
  return {};
}

Result<void> check_payload(std::size_t payload_bytes, std::size_t image_bytes) {
  if (payload_bytes >= image_bytes && payload_bytes - image_bytes <= kMostExtraBytes) return {};
  return failure(Fault::kProtocol, "the camera's PayloadSize is " + std::to_string(payload_bytes) +
                                       " bytes for an image of " + std::to_string(image_bytes) +
                                       "; correct camera.pixel_format and the camera's region, or "
                                       "update its firmware");
}

}  // namespace rig
