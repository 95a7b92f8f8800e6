#include "hw_sim/gige/pixel_format.h"

#include <algorithm>
#include <array>

namespace hw_sim {
namespace {

// Source: EMVA/AIA Pixel Format Naming Convention, "PFNC 32-bit values".
constexpr std::array<PixelFormat, 19> kFormats{{
    {"Mono8", 0x01080001, 8, 1},      {"Mono12", 0x01100005, 12, 1},
    {"Mono16", 0x01100007, 16, 1},    {"BayerGR8", 0x01080008, 8, 1},
    {"BayerRG8", 0x01080009, 8, 1},   {"BayerGB8", 0x0108000A, 8, 1},
    {"BayerBG8", 0x0108000B, 8, 1},   {"BayerGR12", 0x01100010, 12, 1},
    {"BayerRG12", 0x01100011, 12, 1}, {"BayerGB12", 0x01100012, 12, 1},
    {"BayerBG12", 0x01100013, 12, 1}, {"BayerGR16", 0x0110002E, 16, 1},
    {"BayerRG16", 0x0110002F, 16, 1}, {"BayerGB16", 0x01100030, 16, 1},
    {"BayerBG16", 0x01100031, 16, 1}, {"Mono10", 0x01100003, 10, 1},
    {"RGB8", 0x02180014, 8, 3},       {"RGB12", 0x0230001A, 12, 3},
    {"RGB16", 0x02300033, 16, 3},
}};

template <typename Predicate>
std::optional<PixelFormat> find(Predicate predicate) {
  const auto* found = std::find_if(kFormats.begin(), kFormats.end(), predicate);
  if (found == kFormats.end()) return std::nullopt;
  return *found;
}

}  // namespace

std::optional<PixelFormat> find_pixel_format(std::string_view name) {
  return find([&](const PixelFormat& format) { return format.name == name; });
}

std::optional<PixelFormat> find_pixel_format(std::uint32_t code) {
  return find([&](const PixelFormat& format) { return format.code == code; });
}

std::string pixel_format_names() {
  std::string names;
  for (const PixelFormat& format : kFormats) {
    if (!names.empty()) names += ", ";
    names += format.name;
  }
  return names;
}

}  // namespace hw_sim
