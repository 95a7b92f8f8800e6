#include "estimation/profile/profile_point.h"

#include <algorithm>
#include <limits>
#include <optional>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

struct Pixel {
  int row = 0, col = 0;
  bool operator==(const Pixel&) const = default;
};

bool is_valid_in(const Image<std::uint32_t>& validity, Pixel pixel) {
  return (validity.at(pixel.row, pixel.col) & kValidityErrors) == 0;
}

// In image order.
std::vector<Pixel> valid_pixels(const CameraInfo& camera,
                                const std::array<Image<std::uint32_t>, 3>& validity) {
  const auto bands = static_cast<std::size_t>(band_count(camera.pixel_format.filter));
  std::vector<Pixel> valid;
  for (int row = 0; row < camera.height_px; ++row)
    for (int col = 0; col < camera.width_px; ++col)
      if (std::all_of(validity.begin(), validity.begin() + static_cast<std::ptrdiff_t>(bands),
                      [&](const auto& band) {
                        return is_valid_in(band, {row, col});
                      }))
        valid.push_back({row, col});
  return valid;
}

struct Box {
  Pixel low, high;  // both inside
};

Box bounding_box(const std::vector<Pixel>& pixels) {
  Box box{pixels.front(), pixels.front()};
  for (const Pixel& pixel : pixels) {
    box.low = {std::min(box.low.row, pixel.row), std::min(box.low.col, pixel.col)};
    box.high = {std::max(box.high.row, pixel.row), std::max(box.high.col, pixel.col)};
  }
  return box;
}

// Nearest to a quarter or three quarters of the box's height and width.
Pixel nearest_to_quadrant(const std::vector<Pixel>& pixels, const Box& box, Pixel quarters) {
  const double centre_row = box.low.row + 0.25 * quarters.row * (box.high.row - box.low.row);
  const double centre_col = box.low.col + 0.25 * quarters.col * (box.high.col - box.low.col);
  const auto distance = [&](const Pixel& pixel) {
    const double rows = pixel.row - centre_row, cols = pixel.col - centre_col;
    return rows * rows + cols * cols;
  };
  return *std::min_element(pixels.begin(), pixels.end(), [&](const Pixel& a, const Pixel& b) {
    return distance(a) < distance(b);
  });
}

// Within 3 x 3, where a mosaic's pixel takes its value from.
std::optional<Pixel> nearest_site(const CameraInfo& camera, int band,
                                  const Image<std::uint32_t>& validity, Pixel pixel) {
  if (camera.pixel_format.filter == ColorFilter::kRgb) return pixel;
  std::optional<Pixel> nearest;
  int least = std::numeric_limits<int>::max();
  for (int row = std::max(pixel.row - 1, 0); row <= std::min(pixel.row + 1, camera.height_px - 1);
       ++row)
    for (int col = std::max(pixel.col - 1, 0); col <= std::min(pixel.col + 1, camera.width_px - 1);
         ++col) {
      const int distance =
          (row - pixel.row) * (row - pixel.row) + (col - pixel.col) * (col - pixel.col);
      if (band_at(camera, row, col) != band || !is_valid_in(validity, {row, col})) continue;
      if (distance >= least) continue;
      nearest = {row, col};
      least = distance;
    }
  return nearest;
}

}  // namespace

std::vector<ProfilePoint> choose_profile_points(
    const CameraInfo& camera, const std::array<Image<std::uint32_t>, 3>& validity) {
  const std::vector<Pixel> valid = valid_pixels(camera, validity);
  if (valid.empty()) return {};
  const Box box = bounding_box(valid);
  std::vector<Pixel> chosen;
  for (const Pixel quarters : {Pixel{1, 1}, Pixel{1, 3}, Pixel{3, 1}, Pixel{3, 3}}) {
    const Pixel pixel = nearest_to_quadrant(valid, box, quarters);
    if (std::find(chosen.begin(), chosen.end(), pixel) == chosen.end()) chosen.push_back(pixel);
  }
  std::vector<ProfilePoint> points;
  for (const Pixel& pixel : chosen) {
    ProfilePoint point{.row = pixel.row, .col = pixel.col};
    for (int band = 0; band < band_count(camera.pixel_format.filter); ++band) {
      const auto b = static_cast<std::size_t>(band);
      // A valid pixel between the sites has a valid one beside it.
      const Pixel site = nearest_site(camera, band, validity[b], pixel).value_or(pixel);
      point.bands[b].row = site.row;
      point.bands[b].col = site.col;
    }
    points.push_back(std::move(point));
  }
  return points;
}

}  // namespace estimation
