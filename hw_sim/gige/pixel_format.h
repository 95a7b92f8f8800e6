// The pixel formats that the simulated camera can send, by PFNC name and code.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace hw_sim {

struct PixelFormat {
  std::string_view name;   // PFNC
  std::uint32_t code = 0;  // PFNC; bits 16 to 23 are the bits of a pixel
  int bit_depth = 8;       // of a sample, right-aligned in one or two bytes
  int channel_count = 1;

  int bytes_per_sample() const { return bit_depth > 8 ? 2 : 1; }
  int bytes_per_pixel() const { return bytes_per_sample() * channel_count; }
};

std::optional<PixelFormat> find_pixel_format(std::string_view name);
std::optional<PixelFormat> find_pixel_format(std::uint32_t code);
std::string pixel_format_names();  // for messages, separated by ", "

}  // namespace hw_sim
