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
// Of the backdrop: far away and evenly lit by the projector's missing rays.
constexpr double kBackdropCellMm = 150;
constexpr int kBackdropCells = 20;  // along a side: 3 m
constexpr int kLightBlocks = 16;    // partial sums: fixed, so that threads do not change them

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

Vec3 outward(const Vec3& d, const Vec3& normal) {
  const Vec3 aside = std::abs(normal[0]) > 0.5 ? Vec3(0, 1, 0) : Vec3(1, 0, 0);
  Vec3 right = aside.cross(normal);
  right /= cv::norm(right);
  return d[0] * right + d[1] * normal.cross(right) + d[2] * normal;
}

}  // namespace

Interreflection::Interreflection(const Surface& surface, const SkinMap& skin,
                                 const ProjectorLight& light, const SeenPoints& seen,
                                 const TotalReflectance& reflectance_of,
                                 const InterreflectionOptions& options)
    : light_(&light), bounces_(options.bounces), backdrop_(options.backdrop) {
  const auto patch_of_cell = make_patches(surface, skin, reflectance_of);
  surface_patch_count_ = static_cast<std::int32_t>(patches_.size());
  if (backdrop_.reflectance > 0) add_backdrop();
  gather_light(options);
  gather_form_factors(surface);
  interpolate(patch_of_cell, seen);
  for (const SeenSample& sample : seen.samples)
    sample_reflectance_.push_back(static_cast<float>(reflectance_of(sample.scattering)));
}

std::unordered_map<std::int64_t, std::int32_t> Interreflection::make_patches(
    const Surface& surface, const SkinMap& skin, const TotalReflectance& reflectance_of) {
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
  return patch_of_cell;
}

void Interreflection::add_backdrop() {
  const auto reflectance = static_cast<float>(backdrop_.reflectance);
  for (int row = 0; row < kBackdropCells; ++row)
    for (int col = 0; col < kBackdropCells; ++col)
      patches_.push_back(
          {{(col + 0.5 - 0.5 * kBackdropCells) * kBackdropCellMm,
            (row + 0.5 - 0.5 * kBackdropCells) * kBackdropCellMm, backdrop_.distance_mm},
           {0, 0, -1},
           kBackdropCellMm * kBackdropCellMm,
           {reflectance, reflectance, reflectance}});
}

std::int32_t Interreflection::backdrop_patch(const Ray& ray) const {
  if (!(backdrop_.reflectance > 0) || ray.direction[2] <= 0) return -1;
  const Vec3 at =
      ray.origin_mm + (backdrop_.distance_mm - ray.origin_mm[2]) / ray.direction[2] * ray.direction;
  const int col = static_cast<int>(std::floor(at[0] / kBackdropCellMm)) + kBackdropCells / 2;
  const int row = static_cast<int>(std::floor(at[1] / kBackdropCellMm)) + kBackdropCells / 2;
  if (row < 0 || col < 0 || row >= kBackdropCells || col >= kBackdropCells) return -1;
  return surface_patch_count_ + row * kBackdropCells + col;
}

void Interreflection::gather_light(const InterreflectionOptions& options) {
  const LightLattice& lattice = light_->coarse();
  patch_of_light_.assign(lattice.triangle.size(), -1);
  flux_mm2_.assign(lattice.triangle.size(), 0);
  const double area_scale = light_->reference_distance_mm() * light_->reference_distance_mm();
  tbb::parallel_for(0, lattice.height, [&](int row) {
    for (int col = 0; col < lattice.width; ++col) {
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width) +
                     static_cast<std::size_t>(col);
      const int triangle = lattice.triangle[i];
      double flux_mm2 = static_cast<double>(lattice.flux_mm2[i]);
      if (triangle >= 0) {
        patch_of_light_[i] = patch_of_triangle_[static_cast<std::size_t>(triangle)];
      } else if (backdrop_.reflectance > 0) {
        patch_of_light_[i] = backdrop_patch(light_->projector().ray(col, row));
        flux_mm2 = area_scale * light_->projector().solid_angle_sr(col, row, 1);
      }
      if (options.lamp_passes) flux_mm2 *= options.lamp_passes(row, col);
      if (patch_of_light_[i] >= 0) flux_mm2_[i] = static_cast<float>(flux_mm2);
    }
  });
}

void Interreflection::gather_form_factors(const Surface& surface) {
  const std::vector<Vec3> directions = cosine_directions();
  sources_.resize(patches_.size());
  tbb::parallel_for(std::size_t{0}, patches_.size(), [&](std::size_t i) {
    const Patch& patch = patches_[i];
    std::map<std::int32_t, int> hits;  // ordered: the same sum for any number of threads
    for (const Vec3& d : directions) {
      const Ray ray{patch.point_mm + 0.1 * patch.normal, outward(d, patch.normal)};
      const int triangle = surface.first_triangle(ray, 0.3);
      const std::int32_t source = triangle >= 0
                                      ? patch_of_triangle_[static_cast<std::size_t>(triangle)]
                                      : backdrop_patch(ray);
      if (source >= 0) ++hits[source];
    }
    for (const auto& [source, count] : hits)
      if (source != static_cast<std::int32_t>(i))
        sources_[i].push_back({source, static_cast<float>(count) / kRayCount});
  });
}

void Interreflection::interpolate(
    const std::unordered_map<std::int64_t, std::int32_t>& patch_of_cell, const SeenPoints& seen) {
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
}

std::vector<double> Interreflection::direct_irradiance(
    estimation::ImageView<const unsigned char> brightness, const LampResponse& lamp) const {
  const int width = brightness.width_px, height = brightness.height_px;
  std::vector<std::vector<double>> blocks(kLightBlocks);
  tbb::parallel_for(0, kLightBlocks, [&](int block) {
    std::vector<double>& flux_mm2 = blocks[static_cast<std::size_t>(block)];
    flux_mm2.assign(patches_.size(), 0.0);
    for (int row = height * block / kLightBlocks; row < height * (block + 1) / kLightBlocks; ++row)
      for (int col = 0; col < width; ++col) {
        const unsigned char grey = brightness.at(row, col);
        const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                       static_cast<std::size_t>(col);
        if (grey == 0 || patch_of_light_[i] < 0) continue;
        flux_mm2[static_cast<std::size_t>(patch_of_light_[i])] +=
            static_cast<double>(flux_mm2_[i] * lamp.light(grey));
      }
  });
  std::vector<double> irradiance(patches_.size(), 0.0);
  for (const auto& flux_mm2 : blocks)
    for (std::size_t i = 0; i < patches_.size(); ++i) irradiance[i] += flux_mm2[i];
  for (std::size_t i = 0; i < patches_.size(); ++i) irradiance[i] /= patches_[i].area_mm2;
  return irradiance;
}

std::vector<Interreflection::ByBand> Interreflection::bounced(
    const std::vector<ByBand>& irradiance) const {
  std::vector<ByBand> next(patches_.size());
  tbb::parallel_for(std::size_t{0}, patches_.size(), [&](std::size_t i) {
    next[i] = {};
    for (const Share& source : sources_[i]) {
      const auto j = static_cast<std::size_t>(source.patch);
      for (std::size_t band = 0; band < 3; ++band)
        next[i][band] += static_cast<double>(source.weight) * irradiance[j][band] *
                         static_cast<double>(patches_[j].reflectance[band]);
    }
  });
  return next;
}

std::vector<std::array<float, 3>> Interreflection::received(
    estimation::ImageView<const unsigned char> brightness, const LampResponse& lamp) const {
  const std::vector<double> direct = direct_irradiance(brightness, lamp);
  std::vector<ByBand> light(patches_.size()), sum(patches_.size());
  for (std::size_t i = 0; i < patches_.size(); ++i) light[i] = {direct[i], direct[i], direct[i]};
  for (int bounce = 0; bounce < bounces_; ++bounce) {
    light = bounced(light);
    for (std::size_t i = 0; i < patches_.size(); ++i)
      for (std::size_t band = 0; band < 3; ++band) sum[i][band] += light[i][band];
  }
  std::vector<std::array<float, 3>> received(neighbours_.size());
  tbb::parallel_for(std::size_t{0}, neighbours_.size(), [&](std::size_t i) {
    received[i] = {};
    for (const Share& share : neighbours_[i])
      for (std::size_t band = 0; band < 3; ++band)
        received[i][band] +=
            share.weight * static_cast<float>(sum[static_cast<std::size_t>(share.patch)][band]);
  });
  return received;
}

std::vector<float> Interreflection::reflected(estimation::ImageView<const unsigned char> brightness,
                                              const LampResponse& lamp,
                                              const SeenPoints& seen) const {
  const std::vector<std::array<float, 3>> irradiance = received(brightness, lamp);
  std::vector<float> reflected(seen.samples.size());
  for (std::size_t i = 0; i < seen.samples.size(); ++i)
    reflected[i] = sample_reflectance_[i] *
                   irradiance[static_cast<std::size_t>(seen.owners[i])][seen.bands[i]];
  return reflected;
}

}  // namespace hw_sim
