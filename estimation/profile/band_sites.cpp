#include "estimation/profile/band_sites.h"

#include <algorithm>

#include "estimation/session/maps.h"

namespace estimation {

std::vector<Site> valid_sites(const CameraInfo& camera, int band,
                              ImageView<const std::uint32_t> validity) {
  std::vector<Site> sites;
  for (int row = 0; row < camera.height_px; ++row)
    for (int col = 0; col < camera.width_px; ++col)
      if ((validity.at(row, col) & kValidityErrors) == 0 && is_site(camera, band, row, col))
        sites.push_back({row, col});
  return sites;
}

std::vector<Site> evenly_chosen(const std::vector<Site>& sites, std::size_t count) {
  const std::size_t step = std::max<std::size_t>(1, sites.size() / count);
  std::vector<Site> chosen;
  for (std::size_t i = 0; i < sites.size(); i += step) chosen.push_back(sites[i]);
  return chosen;
}

}  // namespace estimation
