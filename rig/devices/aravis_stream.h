// One acquisition of an Aravis camera: its stream, its buffers, and the thread that checks them.
// Internal to the Aravis adapter.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "rig/devices/aravis_chunks.h"
#include "rig/devices/aravis_objects.h"
#include "rig/devices/block_id.h"
#include "rig/devices/frame_memory.h"
#include "rig/event.h"

namespace rig {

// What a sound buffer looks like.
struct FrameFormat {
  int width_px = 0;
  int height_px = 0;
  std::uint32_t pixel_format_code = 0;
  std::string pixel_format;
  std::size_t payload_bytes = 0;

  std::uint32_t bits_per_pixel() const;
  std::size_t image_bytes() const;
};

// Opens the camera's stream: resends asked for, no packet socket. Errors: those of take_error().
Result<GObjectPtr<_ArvStream>> open_stream(_ArvCamera* camera);

class BufferReturn;

// Thread-safe, but for start() and stop().
class Acquisition {
 public:
  struct Parts {
    GObjectPtr<_ArvStream> stream;
    ChunkReader chunks;
    std::shared_ptr<FrameMemory> memory;
    FrameFormat format;
    int frame_count = 0;
  };

  // Posts FrameArrived and FrameDamaged to `sink`, which outlives it.
  Acquisition(Parts parts, EventSink& sink);
  ~Acquisition();
  Acquisition(const Acquisition&) = delete;
  Acquisition& operator=(const Acquisition&) = delete;

  // `trigger_base`: the camera's trigger counter now; it counts from there.
  void start(std::int64_t trigger_base);
  // Nothing is posted afterwards.
  void stop();

  std::int64_t delivered_count() const { return delivered_count_; }
  std::int64_t damaged_count() const { return damaged_count_; }
  std::int64_t resent_packet_count() const;

 private:
  void run(const std::stop_token& stop);
  void handle(_ArvBuffer* buffer);
  std::optional<std::uint64_t> identify(_ArvBuffer* buffer, bool is_whole);
  std::optional<Error> find_defect(_ArvBuffer* buffer,
                                   const std::optional<std::uint64_t>& block_id) const;
  std::optional<std::string> find_image_defect(_ArvBuffer* buffer) const;
  Result<Frame> make_frame(_ArvBuffer* buffer, std::uint64_t block_id) const;

  Parts parts_;
  EventSink& sink_;
  std::shared_ptr<BufferReturn> home_;  // shared: leases outlive the acquisition
  BlockIdCounter block_ids_;            // used by the reader only
  std::int64_t trigger_base_ = 0;
  std::atomic<std::int64_t> delivered_count_{0};
  std::atomic<std::int64_t> damaged_count_{0};
  std::jthread reader_;
};

}  // namespace rig
