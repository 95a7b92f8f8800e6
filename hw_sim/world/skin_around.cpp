#include "hw_sim/world/skin_around.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

namespace {

using estimation::Vec3;

// In spacings of the lattice on the surface: below the one nothing is left to it, above the other
// everything.
constexpr double kNearSpacings = 1.5, kFarSpacings = 4.5;
constexpr double kCoreSpacings = 0.07;  // of the near radius: within this all light is at one place

Vec3 vec(const std::array<float, 3>& v) {
  return {static_cast<double>(v[0]), static_cast<double>(v[1]), static_cast<double>(v[2])};
}

// 1 to 0 over 0..1, smooth to the second derivative.
double fade(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return 1 - t * t * t * (10 - 15 * t + 6 * t * t);
}

}  // namespace

SkinAround::SkinAround(const SkinMaterial& material, const SeenSample& sample,
                       const ProjectorLight& light)
    : light_(light), point_(vec(sample.point_mm)) {
  const Vec3 normal = vec(sample.normal);
  normal_ = normal;
  const Vec3 to_lamp = light.projector().center_mm() - point_;
  const double distance_mm = cv::norm(to_lamp);
  const Vec3 towards_lamp = to_lamp / distance_mm;
  const Vec3 towards_eye = -point_ / cv::norm(point_);
  const double cos_in = std::clamp(towards_lamp.dot(normal), 0.0, 1.0);
  const double cos_out = std::clamp(towards_eye.dot(normal), 0.0, 1.0);
  const Vec3 in_plane = cos_in * normal - towards_lamp;  // where the light travels
  const Vec3 any = std::abs(normal[0]) < 0.9 ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
  along_ = cv::norm(in_plane) > 1e-6
               ? in_plane / cv::norm(in_plane)
               : (any - any.dot(normal) * normal) / cv::norm(any - any.dot(normal) * normal);
  across_ = normal.cross(along_);
  kernel_ = material.kernel(
      {.incidence_rad = std::acos(cos_in),
       .exit_rad = std::acos(cos_out),
       .exit_azimuth_rad = std::atan2(towards_eye.dot(across_), towards_eye.dot(along_))});
  const double nearness = light.reference_distance_mm() / distance_mm;
  irradiance_ = cos_in * nearness * nearness;
  transmission_ = static_cast<float>(1 - fresnel_reflectance(cos_in, 1, kSkinIndex));
  radius2_ = static_cast<float>(kernel_.radius_mm() * kernel_.radius_mm());
  const double spacing_mm = distance_mm / light.projector().focal_px() / std::max(cos_in, 0.15);
  near_mm_ = kNearSpacings * spacing_mm;
  far_mm_ = kFarSpacings * spacing_mm;
}

float SkinAround::at(float distance2, float dx, float dy, float dz) const {
  // From where light enters to the sample.
  const auto component = [&](const Vec3& axis) {
    return -(dx * static_cast<float>(axis[0]) + dy * static_cast<float>(axis[1]) +
             dz * static_cast<float>(axis[2]));
  };
  const float value = transmission_ * kernel_.at(distance2, component(along_), component(across_));
  if (distance2 >= static_cast<float>(far_mm_ * far_mm_)) return value;
  const double distance_mm = std::sqrt(static_cast<double>(distance2));
  return value * static_cast<float>(1 - fade((distance_mm - near_mm_) / (far_mm_ - near_mm_)));
}

// Which way the projector's picture runs on the tangent plane: px a mm, [row, column].
struct SkinAround::Slopes {
  std::array<double, 2> center_px, along, across;
};

SkinAround::Slopes SkinAround::slopes() const {
  const Pinhole& lamp = light_.projector();
  constexpr double kStep_mm = 0.05;
  const ProjectedPoint center = lamp.project(point_);
  const auto slope = [&](const Vec3& axis) {
    const ProjectedPoint a = lamp.project(point_ + kStep_mm * axis);
    const ProjectedPoint b = lamp.project(point_ - kStep_mm * axis);
    return std::array<double, 2>{(a.row_px - b.row_px) / (2 * kStep_mm),
                                 (a.col_px - b.col_px) / (2 * kStep_mm)};
  };
  return {{center.row_px, center.col_px}, slope(along_), slope(across_)};
}

// Least squares over the lattice's points within the near part's reach, the plane included: the
// mesh is not quite where the sample is.
SkinAround::Bend SkinAround::bend() const {
  const LightLattice& lattice = light_.coarse();
  const ProjectedPoint center = light_.projector().project(point_);
  // Lattice points lie closest where the surface faces the projector.
  const double facing_mm =
      cv::norm(light_.projector().center_mm() - point_) / light_.projector().focal_px();
  const int reach_px = std::min(20, static_cast<int>(std::ceil(far_mm_ / facing_mm)));
  constexpr int kTerms = 6;
  constexpr int kLeastPoints = 12;
  cv::Matx<double, kTerms, kTerms> normal_matrix;
  cv::Vec<double, kTerms> right;
  int count = 0;
  for (int dy = -reach_px; dy <= reach_px; ++dy)
    for (int dx = -reach_px; dx <= reach_px; ++dx) {
      const int row = static_cast<int>(std::lround(center.row_px)) + dy;
      const int col = static_cast<int>(std::lround(center.col_px)) + dx;
      if (row < 0 || col < 0 || row >= lattice.height || col >= lattice.width) continue;
      const std::size_t i =
          static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width) +
          static_cast<std::size_t>(col);
      if (!(lattice.flux_mm2[i] > 0)) continue;
      const Vec3 offset =
          Vec3(static_cast<double>(lattice.x_mm[i]), static_cast<double>(lattice.y_mm[i]),
               static_cast<double>(lattice.z_mm[i])) -
          point_;
      if (offset.dot(offset) > far_mm_ * far_mm_) continue;
      const double a = offset.dot(along_) / far_mm_, c = offset.dot(across_) / far_mm_;
      const cv::Vec<double, kTerms> basis(1, a, c, a * a, a * c, c * c);
      normal_matrix += basis * basis.t();
      right += offset.dot(normal_) * basis;
      ++count;
    }
  bool is_regular = false;
  const auto inverse = normal_matrix.inv(cv::DECOMP_CHOLESKY, &is_regular);
  if (count < kLeastPoints || !is_regular) return {};
  const cv::Vec<double, kTerms> fit = inverse * right;
  const double scale = 1 / (far_mm_ * far_mm_);
  return {2 * fit[3] * scale, fit[4] * scale, 2 * fit[5] * scale};
}

SkinAround::Place SkinAround::place_at(double along_mm, double across_mm, const Bend& bend) const {
  const double by_along = bend.along * along_mm + bend.mixed * across_mm;
  const double by_across = bend.mixed * along_mm + bend.across * across_mm;
  const double height_mm = (by_along * along_mm + by_across * across_mm) / 2;
  const Vec3 place = point_ + along_mm * along_ + across_mm * across_ + height_mm * normal_;
  const ProjectedPoint lit = light_.projector().project(place);
  const Vec3 from_here = light_.projector().center_mm() - point_;
  const Vec3 from_there = light_.projector().center_mm() - place;
  const auto flux = [](const Vec3& way, const Vec3& normal) {
    const double distance2 = way.dot(way);
    return normal.dot(way) / (distance2 * std::sqrt(distance2));
  };
  const Vec3 upright = normal_ - by_along * along_ - by_across * across_;
  return {lit.row_px, lit.col_px,
          std::max(0.0, flux(from_there, upright) / flux(from_here, normal_))};
}

bool SkinAround::is_lit(double row_px, double col_px) const {
  const LightLattice& lattice = light_.coarse();
  const int row = static_cast<int>(std::lround(row_px)),
            col = static_cast<int>(std::lround(col_px));
  if (row < 0 || col < 0 || row >= lattice.height || col >= lattice.width) return false;
  const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(lattice.width) +
                        static_cast<std::size_t>(col);
  const double dx = static_cast<double>(lattice.x_mm[i]) - point_[0];
  const double dy = static_cast<double>(lattice.y_mm[i]) - point_[1];
  const double dz = static_cast<double>(lattice.z_mm[i]) - point_[2];
  // A lattice point farther away belongs to another part of the scene.
  return lattice.flux_mm2[i] > 0 && dx * dx + dy * dy + dz * dz < 4 * far_mm_ * far_mm_;
}

std::vector<SkinAround::Patch> SkinAround::near_patches() const {
  std::vector<Patch> patches;
  if (irradiance_ <= 0) return patches;
  const Slopes slopes = this->slopes();
  const Bend bend = this->bend();
  // Rings of two knots, each at their middle; what is nearer than a tenth of a pixel is one patch.
  const double core_mm = kCoreSpacings * near_mm_;
  std::array<double, SkinKernel::kTerms> light{};
  double first_mm = 0;  // of the ring's knots; 0: the core
  bool is_open = true;
  for (std::size_t knot = 0; knot < SkinKernel::kKnots; ++knot) {
    const SkinKernel::Ring ring = kernel_.ring(knot);
    if (ring.radius_mm >= far_mm_) break;
    if (!is_open) {
      first_mm = ring.radius_mm;
      is_open = true;
    }
    const double share = ring.area_mm2 * fade((ring.radius_mm - near_mm_) / (far_mm_ - near_mm_));
    for (std::size_t i = 0; i < SkinKernel::kTerms; ++i) light[i] += share * ring.terms[i];
    if (ring.radius_mm < core_mm || knot % 2 == 0) continue;
    add_ring(light, first_mm, ring.radius_mm, slopes, bend, patches);
    light = {};
    is_open = false;
  }
  if (is_open) add_ring(light, first_mm, far_mm_, slopes, bend, patches);
  return patches;
}

void SkinAround::add_ring(const std::array<double, SkinKernel::kTerms>& light, double first_mm,
                          double last_mm, const Slopes& slopes, const Bend& bend,
                          std::vector<Patch>& patches) const {
  const bool is_core = first_mm == 0;
  const double radius_mm = is_core ? 0 : (first_mm + last_mm) / 2;
  const double width_mm = is_core ? last_mm : 2 * (last_mm - first_mm);
  const int sectors = is_core ? 1 : radius_mm < near_mm_ / 3 ? 8 : radius_mm < near_mm_ ? 16 : 32;
  const double sector_rad = 2 * std::numbers::pi / sectors;
  for (int sector = 0; sector < sectors; ++sector) {
    const double angle = (sector + 0.5) * sector_rad, c = std::cos(angle), s = std::sin(angle);
    const double value = is_core ? light[0]
                                 : light[0] + c * light[1] + s * light[2] +
                                       (c * c - s * s) * light[3] + 2 * c * s * light[4];
    // Light enters at minus the offset to the sample.
    const Place place = place_at(-radius_mm * c, -radius_mm * s, bend);
    const auto extent = [&](std::size_t axis) {
      const double outward = c * slopes.along[axis] + s * slopes.across[axis];
      const double sideways = -s * slopes.along[axis] + c * slopes.across[axis];
      return std::abs(outward) * width_mm +
             std::abs(sideways) * std::max(width_mm, radius_mm * sector_rad);
    };
    const Patch patch{
        .row_px = place.row_px,
        .col_px = place.col_px,
        .row_extent_px = extent(0),
        .col_extent_px = extent(1),
        .weight = value / sectors * static_cast<double>(transmission_) * irradiance_ * place.light};
    if (is_lit(patch.row_px, patch.col_px)) patches.push_back(patch);
  }
}

}  // namespace hw_sim
