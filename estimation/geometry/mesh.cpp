#include "estimation/geometry/mesh.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace estimation {
namespace {

constexpr std::uint32_t kNoVertex = std::numeric_limits<std::uint32_t>::max();
// A gap in the reflectance up to this wide is coloured by what surrounds it.
constexpr int kColorRadiusPx = 3;
constexpr double kGrey = 0.2;

Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col) {
  return {double{image[0].at(row, col)}, double{image[1].at(row, col)},
          double{image[2].at(row, col)}};
}

bool is_finite(const Vec3& v) {
  return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

class Mesher {
 public:
  Mesher(const Maps& maps, const MeshOptions& options)
      : maps_(maps), options_(options), vertex_of_(maps.height_px, maps.width_px, 1, kNoVertex) {}

  Mesh run() {
    mesh_.is_colored = !maps_.diffuse_reflectance[0].empty();
    for (int row = 0; row + 1 < maps_.height_px; ++row)
      for (int col = 0; col + 1 < maps_.width_px; ++col) join(row, col);
    return std::move(mesh_);
  }

 private:
  struct Corner {
    int row = 0, col = 0;
    Vec3 position_mm;
    bool is_there = false;
  };

  Corner corner(int row, int col) const {
    const Vec3 position_mm = vector_at(maps_.position_mm, row, col);
    const bool is_there = is_finite(position_mm) && is_finite(vector_at(maps_.normal, row, col));
    return {row, col, position_mm, is_there};
  }

  // Both are there, and what lies between them is a slope and not a step.
  bool are_joined(const Corner& a, const Corner& b) const {
    if (!a.is_there || !b.is_there) return false;
    const Vec3 view = (a.position_mm + b.position_mm) / cv::norm(a.position_mm + b.position_mm);
    const Vec3 between_mm = b.position_mm - a.position_mm;
    const double depth_mm = view.dot(between_mm);
    const double sideways_mm = cv::norm(between_mm - depth_mm * view);
    return std::abs(depth_mm) <= options_.max_slope * sideways_mm;
  }

  // The square of four neighbours cut along its shorter diagonal, or along the one that is left
  // where a corner is missing.
  void join(int row, int col) {
    const Corner top_left = corner(row, col), top_right = corner(row, col + 1);
    const Corner low_left = corner(row + 1, col), low_right = corner(row + 1, col + 1);
    const auto length_mm = [](const Corner& a, const Corner& b) {
      return a.is_there && b.is_there ? cv::norm(a.position_mm - b.position_mm)
                                      : std::numeric_limits<double>::infinity();
    };
    if (length_mm(top_left, low_right) < length_mm(top_right, low_left)) {
      add({top_left, low_left, low_right});
      add({top_left, low_right, top_right});
    } else {
      add({top_left, low_left, top_right});
      add({top_right, low_left, low_right});
    }
  }

  void add(const std::array<Corner, 3>& corners) {
    const auto& [a, b, c] = corners;
    if (!are_joined(a, b) || !are_joined(b, c) || !are_joined(c, a)) return;
    mesh_.triangles.push_back({vertex(a), vertex(b), vertex(c)});
  }

  std::uint32_t vertex(const Corner& corner) {
    std::uint32_t& index = vertex_of_.at(corner.row, corner.col);
    if (index != kNoVertex) return index;
    index = static_cast<std::uint32_t>(mesh_.vertices.size());
    MeshVertex vertex;
    for (std::size_t i = 0; i < 3; ++i) {
      vertex.position_mm[i] = maps_.position_mm[i].at(corner.row, corner.col);
      vertex.normal[i] = maps_.normal[i].at(corner.row, corner.col);
    }
    if (mesh_.is_colored) vertex.color = color(corner.row, corner.col);
    mesh_.vertices.push_back(vertex);
    return index;
  }

  std::array<std::uint8_t, 3> color(int row, int col) const {
    Vec3 linear;
    for (int band = 0; band < 3; ++band)
      linear[band] = reflectance(std::min(band, maps_.band_count - 1), row, col);
    if (options_.color_matrix) linear = *options_.color_matrix * linear;
    std::array<std::uint8_t, 3> coded{};
    for (std::size_t i = 0; i < 3; ++i) {
      const double value = std::clamp(linear[static_cast<int>(i)], 0.0, 1.0);
      const double srgb =
          value <= 0.0031308 ? 12.92 * value : 1.055 * std::pow(value, 1 / 2.4) - 0.055;
      coded[i] = static_cast<std::uint8_t>(std::lround(255 * srgb));
    }
    return coded;
  }

  double reflectance(int band, int row, int col) const {
    const Image<float>& image = maps_.diffuse_reflectance[static_cast<std::size_t>(band)];
    if (image.empty()) return kGrey;
    if (const double own = double{image.at(row, col)}; std::isfinite(own)) return own;
    double sum = 0;
    int count = 0;
    for (int r = std::max(row - kColorRadiusPx, 0);
         r <= std::min(row + kColorRadiusPx, maps_.height_px - 1); ++r)
      for (int c = std::max(col - kColorRadiusPx, 0);
           c <= std::min(col + kColorRadiusPx, maps_.width_px - 1); ++c) {
        const double value = double{image.at(r, c)};
        if (!std::isfinite(value)) continue;
        sum += value;
        ++count;
      }
    return count > 0 ? sum / count : kGrey;
  }

  const Maps& maps_;
  const MeshOptions& options_;
  Image<std::uint32_t> vertex_of_;
  Mesh mesh_;
};

}  // namespace

Mesh make_mesh(const Maps& maps, const MeshOptions& options) {
  if (maps.position_mm[0].empty() || maps.normal[0].empty()) return {};
  return Mesher(maps, options).run();
}

}  // namespace estimation
