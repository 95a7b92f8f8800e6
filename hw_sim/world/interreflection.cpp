#include "hw_sim/world/interreflection.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <unordered_map>

namespace hw_sim {

using estimation::Vec3;

namespace {

// 6 mm: a nostril wing is one or two patches; about two thousand patches a head.
constexpr double kPatchMm = 6;
// Rays per form factor row: 1024 in a low-discrepancy order put the received light within about 1%.
constexpr int kRayCount = 1024;

struct Cell {
  std::array<int, 3> index{};
  std::int64_t key() const {
    // 20 bits each hold +-3 km of cells.
    const auto part = [](int i) { return static_cast<std::int64_t>(i) + (1 << 19); };
    return (part(index[0]) << 40) | (part(index[1]) << 20) | part(index[2]);
  }
};

Cell cell_of(const Vec3& point_mm) {
  Cell cell;
  for (int axis = 0; axis < 3; ++axis)
    cell.index[static_cast<std::size_t>(axis)] =
        static_cast<int>(std::floor(point_mm[axis] / kPatchMm));
  return cell;
}

// Directions over a hemisphere with density cosine / pi: the share of rays that hit something is
// its form factor.
std::vector<Vec3> cosine_directions() {
  std::vector<Vec3> directions;
  // The two-dimensional golden ratio's additive recurrence (Roberts' R2).
  constexpr double kRatio = 1.32471795724474602596;
  for (int i = 0; i < kRayCount; ++i) {
    const double u = std::fmod((i + 0.5) / kRatio, 1.0);
    const double v = std::fmod((i + 0.5) / (kRatio * kRatio), 1.0);
    const double radius = std::sqrt(u), angle = 2 * std::numbers::pi * v;
    directions.emplace_back(radius * std::cos(angle), radius * std::sin(angle), std::sqrt(1 - u));
  }
  return directions;
}

}  // namespace

Interreflection::Interreflection(const Surface& surface, const SkinMap& skin,
                                 const ProjectorLight& light, const SeenPoints& seen,
                                 const TotalReflectance& reflectance_of)
    : light_(&light) {
  const Mesh& mesh = surface.mesh();
  std::unordered_map<std::int64_t, std::int32_t> patch_of_cell;
  patch_of_triangle_.resize(static_cast<std::size_t>(mesh.triangle_count()));
  for (int i = 0; i < mesh.triangle_count(); ++i) {
    const Vec3 a = mesh.vertex(3 * i), b = mesh.vertex(3 * i + 1), c = mesh.vertex(3 * i + 2);
    const Vec3 center = (a + b + c) / 3;
    const auto [found, is_new] = patch_of_cell.try_emplace(
        cell_of(center).key(), static_cast<std::int32_t>(patches_.size()));
    if (is_new) patches_.push_back({{0, 0, 0}, {0, 0, 0}, 0, {}});
    Patch& patch = patches_[static_cast<std::size_t>(found->second)];
    const double area_mm2 = cv::norm((b - a).cross(c - a)) / 2;
    patch.point_mm += area_mm2 * center;
    patch.area_mm2 += area_mm2;
    patch_of_triangle_[static_cast<std::size_t>(i)] = found->second;
  }
  tbb::parallel_for(std::size_t{0}, patches_.size(), [&](std::size_t i) {
    Patch& patch = patches_[i];
    patch.point_mm /= std::max(patch.area_mm2, 1e-9);
    // The mean of a curved patch lies off the surface: back onto it.
    for (int step = 0; step < 3; ++step) {
      patch.normal = normal_at(surface.shape(), patch.point_mm);
      patch.point_mm -= surface.shape().distance_mm(patch.point_mm) * patch.normal;
    }
    const Skin here = skin.at(patch.point_mm);
    for (std::size_t band = 0; band < 3; ++band)
      patch.reflectance[band] = static_cast<float>(reflectance_of(here.material.bands[band]));
  });
  gather_form_factors(surface);

  neighbours_.resize(seen.points.size());
  tbb::parallel_for(std::size_t{0}, seen.points.size(), [&](std::size_t i) {
    const Vec3 at = seen.points[i].point_mm - Vec3::all(kPatchMm / 2);
    const Cell low = cell_of(at);
    Shares& shares = neighbours_[i];
    float sum = 0;
    for (int corner = 0; corner < 8; ++corner) {
      Cell cell = low;
      double weight = 1;
      for (int axis = 0; axis < 3; ++axis) {
        const int step = corner >> axis & 1;
        const double within = at[axis] / kPatchMm - low.index[static_cast<std::size_t>(axis)];
        cell.index[static_cast<std::size_t>(axis)] += step;
        weight *= step == 1 ? within : 1 - within;
      }
      const auto found = patch_of_cell.find(cell.key());
      if (found == patch_of_cell.end()) continue;
      // A patch that looks elsewhere (the other wall of a fold) has other light.
      const Vec3& normal = patches_[static_cast<std::size_t>(found->second)].normal;
      weight *= std::max(0.0, normal.dot(seen.points[i].normal));
      shares[static_cast<std::size_t>(corner)] = {found->second, static_cast<float>(weight)};
      sum += static_cast<float>(weight);
    }
    if (sum > 0)
      for (Share& share : shares) share.weight /= sum;
  });
  for (const SeenSample& sample : seen.samples)
    sample_reflectance_.push_back(static_cast<float>(reflectance_of(sample.scattering)));
}

void Interreflection::gather_form_factors(const Surface& surface) {
  const std::vector<Vec3> directions = cosine_directions();
  sources_.resize(patches_.size());
  tbb::parallel_for(std::size_t{0}, patches_.size(), [&](std::size_t i) {
    const Patch& patch = patches_[i];
    const Vec3 aside = std::abs(patch.normal[0]) > 0.5 ? Vec3(0, 1, 0) : Vec3(1, 0, 0);
    Vec3 right = aside.cross(patch.normal);
    right /= cv::norm(right);
    const Vec3 up = patch.normal.cross(right);
    std::map<std::int32_t, int> hits;  // ordered: the same sum for any number of threads
    for (const Vec3& d : directions) {
      const Ray ray{patch.point_mm + 0.1 * patch.normal,
                    d[0] * right + d[1] * up + d[2] * patch.normal};
      const int triangle = surface.first_triangle(ray, 0.3);
      if (triangle >= 0) ++hits[patch_of_triangle_[static_cast<std::size_t>(triangle)]];
    }
    for (const auto& [source, count] : hits)
      if (source != static_cast<std::int32_t>(i))
        sources_[i].push_back({source, static_cast<float>(count) / kRayCount});
  });
}

std::vector<std::array<float, 3>> Interreflection::received(
    estimation::ImageView<const unsigned char> brightness) const {
  const LightLattice& lattice = light_->coarse();
  std::vector<double> flux_mm2(patches_.size(), 0.0);
  for (int row = 0; row < lattice.height; ++row)
    for (int col = 0; col < lattice.width; ++col) {
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width) +
                     static_cast<std::size_t>(col);
      const int triangle = lattice.triangle[i];
      const unsigned char lit = brightness.at(row, col);
      if (triangle < 0 || lit == 0) continue;
      const auto patch = patch_of_triangle_[static_cast<std::size_t>(triangle)];
      flux_mm2[static_cast<std::size_t>(patch)] +=
          static_cast<double>(lattice.flux_mm2[i]) * static_cast<double>(lit) / 255;
    }
  std::vector<std::array<float, 3>> on_patch(patches_.size());
  for (std::size_t i = 0; i < patches_.size(); ++i) {
    std::array<double, 3> sum{};
    for (const Share& source : sources_[i]) {
      const auto j = static_cast<std::size_t>(source.patch);
      const double irradiance = flux_mm2[j] / patches_[j].area_mm2;
      for (std::size_t band = 0; band < 3; ++band)
        sum[band] += static_cast<double>(source.weight) * irradiance *
                     static_cast<double>(patches_[j].reflectance[band]);
    }
    for (std::size_t band = 0; band < 3; ++band) on_patch[i][band] = static_cast<float>(sum[band]);
  }
  std::vector<std::array<float, 3>> received(neighbours_.size());
  tbb::parallel_for(std::size_t{0}, neighbours_.size(), [&](std::size_t i) {
    received[i] = {};
    for (const Share& share : neighbours_[i])
      for (std::size_t band = 0; band < 3; ++band)
        received[i][band] += share.weight * on_patch[static_cast<std::size_t>(share.patch)][band];
  });
  return received;
}

void Interreflection::add_light(estimation::ImageView<const unsigned char> brightness,
                                const SeenPoints& seen, std::vector<float>& linear) const {
  const std::vector<std::array<float, 3>> irradiance = received(brightness);
  for (std::size_t i = 0; i < seen.samples.size(); ++i)
    linear[static_cast<std::size_t>(seen.samples[i].sample)] +=
        sample_reflectance_[i] *
        irradiance[static_cast<std::size_t>(seen.owners[i])][seen.bands[i]];
}

}  // namespace hw_sim
