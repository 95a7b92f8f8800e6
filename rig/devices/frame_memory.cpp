#include "rig/devices/frame_memory.h"

#include <sys/mman.h>
#include <unistd.h>

#include <fstream>
#include <limits>
#include <string>

namespace rig {
namespace {

// What the kernel can give without swapping; unlimited where it does not say.
std::size_t available_bytes() {
  std::ifstream info("/proc/meminfo");
  std::string key;
  std::size_t value_kib = 0;
  std::string unit;
  while (info >> key >> value_kib) {
    if (key == "MemAvailable:") return value_kib * 1024;
    std::getline(info, unit);
  }
  return std::numeric_limits<std::size_t>::max();
}

std::string mebibytes(std::size_t bytes) { return std::to_string(bytes >> 20) + " MiB"; }

// Every page gets its memory before the first trigger. Page by page and not by MAP_POPULATE, which
// for gigabytes keeps the address space locked for seconds: the camera's heartbeat would stop.
void touch(void* start, std::size_t byte_count, std::size_t page_bytes) {
  auto* bytes = static_cast<volatile std::byte*>(start);
  for (std::size_t i = 0; i < byte_count; i += page_bytes) bytes[i] = std::byte{0};
}

}  // namespace

Result<std::shared_ptr<FrameMemory>> FrameMemory::allocate(std::size_t block_count,
                                                           std::size_t block_bytes) {
  const auto page_bytes = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t stride = (block_bytes + page_bytes - 1) / page_bytes * page_bytes;
  const std::size_t total = stride * block_count;
  // Populating more than there is would wake the out-of-memory killer instead of failing.
  if (total > available_bytes())
    return failure(Fault::kOutOfRange, std::to_string(block_count) + " frame buffers need " +
                                           mebibytes(total) + " but only " +
                                           mebibytes(available_bytes()) +
                                           " of memory are free; use a smaller region or fewer "
                                           "frames");
  void* start = mmap(nullptr, total, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (start == MAP_FAILED)
    return failure(Fault::kOutOfRange, "cannot map " + mebibytes(total) + " of frame buffers");
  touch(start, total, page_bytes);
  return std::shared_ptr<FrameMemory>(
      new FrameMemory(static_cast<std::byte*>(start), block_count, block_bytes, stride));
}

FrameMemory::FrameMemory(std::byte* start, std::size_t block_count, std::size_t block_bytes,
                         std::size_t stride)
    : start_(start), block_count_(block_count), block_bytes_(block_bytes), stride_(stride) {}

FrameMemory::~FrameMemory() { munmap(start_, stride_ * block_count_); }

}  // namespace rig
