// EXR files: maps, vignetting, flat field, stripe transfer.
#include "estimation/session/exr.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto* first = reinterpret_cast<const std::byte*>(data);
  const auto file = estimation::decode_exr({first, first + size}, "maps/a.exr");
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
