// Whole files into memory, of a size that what they hold can have: neither a pipe that nobody
// writes nor a device without an end makes a program wait or run out of memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "estimation/session/error.h"

namespace estimation {

// Errors: kNotFound; kUnreadable for what is not permitted, is no regular file, or has more than
// `max_byte_count` bytes. Thread-safe, as all here.
Result<std::vector<std::byte>> read_file(const std::filesystem::path& path,
                                         std::uint64_t max_byte_count);

// 100 bytes a frame record: room for three hundred thousand frames.
inline constexpr std::uint64_t kLargestTextBytes = std::uint64_t{32} << 20U;

// A manifest, calibration, journal or chart. Errors as of read_file().
Result<std::string> read_text(const std::filesystem::path& path);

}  // namespace estimation
