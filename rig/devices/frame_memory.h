// The camera's frame buffers: one block of memory, touched before the first trigger.
#pragma once

#include <cstddef>
#include <memory>

#include "rig/fault.h"

namespace rig {

// Fixed-size blocks. Thread-safe once made. Shared by the camera and its leases: whoever is last
// frees it, so that frames outlive the camera.
class FrameMemory {
 public:
  // Errors: kOutOfRange if the machine cannot spare that much.
  static Result<std::shared_ptr<FrameMemory>> allocate(std::size_t block_count,
                                                       std::size_t block_bytes);
  ~FrameMemory();
  FrameMemory(const FrameMemory&) = delete;
  FrameMemory& operator=(const FrameMemory&) = delete;

  std::byte* block(std::size_t index) const { return start_ + index * stride_; }
  std::size_t block_count() const { return block_count_; }
  std::size_t block_bytes() const { return block_bytes_; }

 private:
  FrameMemory(std::byte* start, std::size_t block_count, std::size_t block_bytes,
              std::size_t stride);
  std::byte* start_;
  std::size_t block_count_;
  std::size_t block_bytes_;
  std::size_t stride_;
};

}  // namespace rig
