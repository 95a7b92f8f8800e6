#include "estimation/motion/picture_series.h"

#include <algorithm>

namespace estimation {
LitTable make_table(const CameraInfo& camera, const BracketPictures& pictures,
                    const std::vector<std::size_t>& frames) {
  const std::size_t place_count = pictures.shown[frames.front()].picture->samples_dn.size();
  const double limit_dn = clip_level_dn(camera);
  std::vector<std::uint16_t> highest(place_count);
  std::vector<std::uint32_t> sums(place_count);
  for (const std::size_t frame : frames) {
    const auto& samples = pictures.shown[frame].picture->samples_dn;
    for (std::size_t i = 0; i < place_count; ++i) {
      highest[i] = std::max(highest[i], samples[i]);
      sums[i] += samples[i];
    }
  }
  const double black_dn = camera.black_level_dn.value_or(0);
  std::vector<std::pair<double, std::size_t>> usable;  // mean light, place
  for (std::size_t i = 0; i < place_count; ++i)
    if (highest[i] < limit_dn)
      usable.emplace_back(sums[i] / static_cast<double>(frames.size()) - black_dn, i);
  LitTable table;
  if (!usable.empty()) {
    std::vector<std::pair<double, std::size_t>> sorted = usable;
    const auto bright =
        sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) * 95 / 100);
    std::nth_element(sorted.begin(), bright, sorted.end());
    constexpr double kLitFrac = 0.1;
    for (const auto& [light_dn, place] : usable)
      if (light_dn > kLitFrac * bright->first && light_dn > 0) table.places.push_back(place);
  }
  for (const std::size_t frame : frames)
    table.light_dn.push_back(light_at(camera, table, *pictures.shown[frame].picture));
  return table;
}

std::vector<float> light_at(const CameraInfo& camera, const LitTable& table,
                            const SeenPicture& picture) {
  const auto black_dn = static_cast<float>(camera.black_level_dn.value_or(0));
  std::vector<float> light(table.places.size());
  const auto limit_dn = static_cast<float>(clip_level_dn(camera));
  for (std::size_t i = 0; i < light.size(); ++i)
    light[i] =
        std::min(static_cast<float>(picture.samples_dn[table.places[i]]), limit_dn) - black_dn;
  return light;
}

}  // namespace estimation
