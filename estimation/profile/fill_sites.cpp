#include "estimation/profile/fill_sites.h"

#include <oneapi/tbb/parallel_for.h>

#include <limits>

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kWeight[3] = {1, 2, 1};

struct Neighbours {
  struct Site {
    int row, col;
    float weight;
  };
  Site sites[9];
  int count = 0;
  std::uint32_t errors = 0;    // of the invalid sites
  std::uint32_t warnings = 0;  // of the valid ones
};

// The valid sites of `band` around a pixel. Reads sites only, so pixels may be filled in any order.
Neighbours neighbours_of(const CameraInfo& camera, int band, const Image<std::uint32_t>& validity,
                         int row, int col) {
  Neighbours found;
  for (int dr = -1; dr <= 1; ++dr)
    for (int dc = -1; dc <= 1; ++dc) {
      const int r = row + dr, c = col + dc;
      if (r < 0 || c < 0 || r >= camera.height_px || c >= camera.width_px) continue;
      if (band_at(camera, r, c) != band) continue;
      const std::uint32_t bits = validity.at(r, c);
      if ((bits & kValidityErrors) != 0) {
        found.errors |= bits & kValidityErrors;
        continue;
      }
      found.warnings |= bits;
      found.sites[found.count++] = {r, c, kWeight[dr + 1] * kWeight[dc + 1]};
    }
  return found;
}

float weighted_mean(const Image<float>& map, const Neighbours& near) {
  float sum = 0, weight = 0;
  for (int i = 0; i < near.count; ++i) {
    sum += near.sites[i].weight * map.at(near.sites[i].row, near.sites[i].col);
    weight += near.sites[i].weight;
  }
  return sum / weight;
}

}  // namespace

void fill_between_sites(const CameraInfo& camera, int band,
                        ImageView<const std::uint32_t> pixel_validity, BandFit& fit) {
  const ColorFilter filter = camera.pixel_format.filter;
  if (filter == ColorFilter::kMono || filter == ColorFilter::kRgb) return;  // every pixel is a site
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col) {
      if (band_at(camera, row, col) == band) continue;
      const std::uint32_t own = pixel_validity.at(row, col);
      const Neighbours near = neighbours_of(camera, band, fit.validity, row, col);
      const bool is_valid = (own & kValidityErrors) == 0 && near.count > 0;
      for (Image<float>* map : fit.images())
        if (!map->empty()) map->at(row, col) = is_valid ? weighted_mean(*map, near) : kNan;
      std::uint32_t bits = own;
      if (is_valid)
        bits |= near.warnings;
      else if ((own & kValidityErrors) == 0)
        bits |= near.errors != 0 ? near.errors : kNotIdentifiable;
      fit.validity.at(row, col) = bits;
    }
  });
}

}  // namespace estimation
