// The camera pixels that see a band: all of an RGB or mono camera, one colour's of a mosaic.
#pragma once

#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct Site {
  int row = 0, col = 0;
  bool operator==(const Site&) const = default;
};

// The frames' channel that holds the band.
inline int channel_of(const CameraInfo& camera, int band) {
  return camera.pixel_format.filter == ColorFilter::kRgb ? band : 0;
}

inline bool is_site(const CameraInfo& camera, int band, int row, int col) {
  return band_at(camera, row, col, channel_of(camera, band)) == band;
}

// From one site of a band to the next along a row or column of the frame, on average.
inline int site_step_px(const CameraInfo& camera) {
  const ColorFilter filter = camera.pixel_format.filter;
  return filter == ColorFilter::kMono || filter == ColorFilter::kRgb ? 1 : 2;
}

// The sites without an error in `validity`, in image order. Runs in the caller's oneTBB arena.
std::vector<Site> valid_sites(const CameraInfo& camera, int band,
                              ImageView<const std::uint32_t> validity);

// About `count` of them, evenly chosen, in the same order; all if there are no more.
std::vector<Site> evenly_chosen(const std::vector<Site>& sites, std::size_t count);

}  // namespace estimation
