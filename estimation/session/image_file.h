// TIFF and PNG files: what their headers promise, and their samples. Private to this folder's .cpp
// files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"

namespace estimation {

struct ImageHeader {
  std::int64_t width_px = 0;
  std::int64_t height_px = 0;
  int channel_count = 0;  // 1 or 3
  int bit_depth = 0;      // 8 or 16
};

// Reads the headers alone, and whether the file holds every byte they promise, before a decoder
// allocates anything. `file` is the name for messages. Errors: kUnreadable for what is truncated,
// damaged or neither TIFF nor PNG; kInvalid for kinds of them that a session may not use.
Result<ImageHeader> probe_image(const std::vector<std::byte>& bytes, const std::string& file);

// The samples of a probed image, three channels in RGB order. Errors: kUnreadable.
Result<Image<std::uint16_t>> decode_image(const std::vector<std::byte>& bytes,
                                          const ImageHeader& header, const std::string& file);

}  // namespace estimation
