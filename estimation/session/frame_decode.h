// A frame from bytes already read, for verify, which hashes them too. Private to this folder's .cpp
// files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// As read_frame, from memory; `file` is the name for messages.
Result<Image<std::uint16_t>> decode_frame(const std::vector<std::byte>& bytes,
                                          const CameraInfo& camera, const std::string& file);

// A bound on the bytes of any file that can hold one of the camera's frames.
std::uint64_t largest_frame_file(const CameraInfo& camera);

}  // namespace estimation
