// EXR files: maps, vignetting, flat field, stripe transfer. The data window is kept small: what a
// header may ask for is a test's business (estimation_session_test), and clearing 64 MiB for each
// input would leave the decoders untried.
#include <algorithm>
#include <string_view>

#include "estimation/session/exr.h"
#include "tests/fuzz/fuzz_target.h"

namespace {

// The side of a window so large that it is brought back into a few px.
constexpr std::uint32_t kLargestSide_px = 256;

void shrink_window(std::vector<std::byte>& bytes, std::string_view name) {
  const auto at = std::search(bytes.begin(), bytes.end(), name.begin(), name.end(),
                              [](std::byte b, char c) { return b == static_cast<std::byte>(c); });
  constexpr std::size_t kTypeAndSize = 10;  // "box2i", 0, 16 as 32 bit
  std::uint32_t corners[4];                 // x and y of the first and the last pixel
  if (static_cast<std::size_t>(bytes.end() - at) < name.size() + kTypeAndSize + sizeof corners)
    return;
  std::byte* window = &*at + name.size() + kTypeAndSize;
  std::memcpy(corners, window, sizeof corners);
  for (const std::size_t axis : {0U, 1U}) {
    const std::uint32_t side_px = corners[axis + 2] - corners[axis];
    if (side_px >= kLargestSide_px && side_px < 0x80000000U)
      corners[axis + 2] = corners[axis] + side_px % kLargestSide_px;
  }
  std::memcpy(window, corners, sizeof corners);
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto* first = reinterpret_cast<const std::byte*>(data);
  std::vector<std::byte> bytes(first, first + size);
  shrink_window(bytes, std::string_view("dataWindow\0", 11));
  const auto file = estimation::decode_exr(bytes, "maps/a.exr");
  if (!file) {
    fuzz::require_message(file.error().text(), "maps/a.exr");
    return 0;
  }
  const auto& channels = file->channels;
  for (const auto& [name, image] : channels) {
    estimation::check(image.width_px() == channels.begin()->second.width_px() &&
                          image.height_px() == channels.begin()->second.height_px(),
                      "the channels of a file are of one size");
  }
  return 0;
}
