#include "estimation/profile/band_sites.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>

#include "estimation/session/maps.h"

namespace estimation {

std::vector<Site> valid_sites(const CameraInfo& camera, int band,
                              ImageView<const std::uint32_t> validity) {
  std::vector<std::vector<Site>> of_row(static_cast<std::size_t>(camera.height_px));
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    std::vector<Site>& sites = of_row[static_cast<std::size_t>(row)];
    for (int col = 0; col < camera.width_px; ++col)
      if ((validity.at(row, col) & kValidityErrors) == 0 && is_site(camera, band, row, col))
        sites.push_back({row, col});
  });
  std::vector<Site> all;
  for (const std::vector<Site>& sites : of_row) all.insert(all.end(), sites.begin(), sites.end());
  return all;
}

std::vector<Site> evenly_chosen(const std::vector<Site>& sites, std::size_t count) {
  const std::size_t step = std::max<std::size_t>(1, sites.size() / count);
  std::vector<Site> chosen;
  for (std::size_t i = 0; i < sites.size(); i += step) chosen.push_back(sites[i]);
  return chosen;
}

}  // namespace estimation
