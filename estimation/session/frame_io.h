// Raw frames of a session: one TIFF or PNG each, 8 or 16 bit, one channel (mono, Bayer) or three
// (RGB order).
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// The frame's samples, DN, right-aligned, black not removed; checked against the manifest's size,
// channel count and bit depth. `file` is relative to the session folder. Thread-safe.
Result<Image<std::uint16_t>> read_frame(const std::filesystem::path& session,
                                        const Manifest& manifest, const std::string& file);

// An uncompressed TIFF in memory; 8 bit if `bit_depth` is 8, else 16 bit.
Result<std::vector<std::byte>> encode_frame_tiff(ImageView<const std::uint16_t> frame,
                                                 int bit_depth);

std::string sha256_hex(const std::vector<std::byte>& bytes);

// Writes under a temporary name (".tmp" appended), syncs the file, renames it, syncs the folder:
// afterwards the file is whole or absent. An existing file of that name is replaced.
Result<void> write_file_atomically(const std::filesystem::path& path,
                                   const std::vector<std::byte>& bytes);

// Gives a file that was written under another name its own: synced, renamed, the folder synced, so
// that it is whole or absent whatever happens. Errors: kUnwritable, about `path`.
Result<void> put_in_place(const std::filesystem::path& written, const std::filesystem::path& path);

}  // namespace estimation
