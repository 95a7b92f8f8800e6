#include "estimation/session/transfer_file.h"

#include <cmath>
#include <cstdio>

namespace estimation {
namespace {

std::string channel_name(char letter, int n) {
  return std::string(1, letter).append(".").append(std::to_string(n));
}

std::optional<std::string> value_problem(const Image<float>& contrast, const std::string& channel) {
  for (int row = 0; row < contrast.height_px(); ++row)
    for (int col = 0; col < contrast.width_px(); ++col) {
      const auto value = static_cast<double>(contrast.at(row, col));
      if (std::isnan(value) || (value >= 0 && value <= kLargestTransfer)) continue;
      char text[160];
      std::snprintf(text, sizeof text,
                    "has %.4g in channel %s at column %d, row %d; expected a contrast over that of "
                    "no cycles, 0 to %g: optics never add contrast",
                    value, channel.c_str(), col, row, kLargestTransfer);
      return text;
    }
  return std::nullopt;
}

}  // namespace

const Image<float>* transfer_channel(const std::map<std::string, Image<float>>& file,
                                     ColorFilter filter, int band, int n) {
  auto channel = file.find(channel_name("RGB"[band], n));
  if (channel == file.end() && filter == ColorFilter::kMono)
    channel = file.find(channel_name('Y', n));
  return channel == file.end() ? nullptr : &channel->second;
}

std::optional<std::string> transfer_file_problem(const std::map<std::string, Image<float>>& file,
                                                 const CameraInfo& camera) {
  const ColorFilter filter = camera.pixel_format.filter;
  for (int band = 0; band < band_count(filter); ++band) {
    if (transfer_channel(file, filter, band, 1) == nullptr)
      return "has no channel " + channel_name("RGB"[band], 1) +
             "; expected R.1 R.2 ... for every band";
    for (int n = 1; const Image<float>* contrast = transfer_channel(file, filter, band, n); ++n) {
      if (contrast->width_px() != camera.width_px || contrast->height_px() != camera.height_px)
        return "is " + std::to_string(contrast->width_px()) + " x " +
               std::to_string(contrast->height_px()) + " px; expected " +
               std::to_string(camera.width_px) + " x " + std::to_string(camera.height_px);
      if (auto problem = value_problem(*contrast, channel_name("RGB"[band], n))) return problem;
    }
  }
  return std::nullopt;
}

}  // namespace estimation
