#include "estimation/motion/picture_samples.h"

#include <algorithm>
#include <cmath>

namespace estimation {
namespace {

constexpr int kMostAcross = 216, kMostDown = 150;

// A number of its own for each cell, the same on every computer (splitmix64).
std::uint64_t hash(std::uint64_t value) {
  value += 0x9e3779b97f4a7c15U;
  value = (value ^ (value >> 30U)) * 0xbf58476d1ce4e5b9U;
  value = (value ^ (value >> 27U)) * 0x94d049bb133111ebU;
  return value ^ (value >> 31U);
}

bool is_bayer(ColorFilter filter) {
  return filter != ColorFilter::kMono && filter != ColorFilter::kRgb;
}

}  // namespace

PictureSampler::PictureSampler(const CameraInfo& camera)
    : channel_(camera.pixel_format.filter == ColorFilter::kRgb ? 1 : 0) {
  // Of a Bayer filter one site of each quad.
  const int quad_px = is_bayer(camera.pixel_format.filter) ? 2 : 1;
  const int quads_down = camera.height_px / quad_px, quads_across = camera.width_px / quad_px;
  const int down = std::min(kMostDown, quads_down), across = std::min(kMostAcross, quads_across);
  for (int i = 0; i < down; ++i) {
    for (int k = 0; k < across; ++k) {
      // Anywhere in its cell: even steps might see a few phases of the stripes only.
      const std::uint64_t own = hash(static_cast<std::uint64_t>(i * across + k));
      const double part_down = static_cast<double>(own & 0xffffU) / 0x10000,
                   part_across = static_cast<double>((own >> 16U) & 0xffffU) / 0x10000;
      const int row = static_cast<int>((i + part_down) * quads_down / down);
      const int col = static_cast<int>((k + part_across) * quads_across / across);
      places_.push_back(
          {quad_px * std::min(row, quads_down - 1), quad_px * std::min(col, quads_across - 1)});
    }
  }
}

std::vector<std::uint16_t> PictureSampler::take(ImageView<const std::uint16_t> frame_dn) const {
  std::vector<std::uint16_t> samples;
  samples.reserve(places_.size());
  for (const Place& place : places_) samples.push_back(frame_dn.at(place.row, place.col, channel_));
  return samples;
}

}  // namespace estimation
