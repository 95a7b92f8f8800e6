#include "hw_sim/photons/lamp.h"

#include <cmath>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

using estimation::Vec3;

namespace {

constexpr double kRatio = 1 / kSkinIndex;

struct Refraction {
  double cos_in = 0, cos_below = 0;
  Vec3 direction;  // below
};

// `way` travels towards the surface. At grazing incidence and beyond: as at grazing.
Refraction refracted(const Vec3& way, const Vec3& normal) {
  Refraction r;
  r.cos_in = -way.dot(normal);
  const double cosine = std::max(r.cos_in, 1e-4);
  r.cos_below = std::sqrt(1 - kRatio * kRatio * (1 - cosine * cosine));
  const Vec3 along = way + r.cos_in * normal;  // in the surface
  const double sine = cv::norm(along), sine_below = std::sqrt(1 - r.cos_below * r.cos_below);
  r.direction = -r.cos_below * normal;
  if (sine > 1e-12) r.direction += (sine_below / sine) * along;
  return r;
}

// How much wider than a solid angle at the lamp the pencil's section is at the point, mm^2/sr.
double pencil_mm2_per_sr(const ShapeGrid& shape, const UnscatteredLight& light, const Vec3& way,
                         double distance_mm, const Refraction& r) {
  const Vec3& normal = light.normal;
  const Vec3 any = std::abs(way[0]) < 0.9 ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
  Vec3 first = any - any.dot(way) * way;
  first /= cv::norm(first);
  const Vec3 second = way.cross(first);
  const auto moved = [&](const Vec3& turn) {  // of the point, for a turn of the ray at the lamp
    const Vec3 on_surface = distance_mm * (turn + way * (normal.dot(turn) / r.cos_in));
    const double length = cv::norm(on_surface);
    constexpr double kStepMm = 0.05;
    const Vec3 step = on_surface * (kStepMm / length);
    const Vec3 normal_turn = (shape.normal(light.entry_mm + step) - normal) * (length / kStepMm);
    const double cos_turn = -(turn.dot(normal) + way.dot(normal_turn));
    const double below_turn = kRatio * kRatio * r.cos_in * cos_turn / r.cos_below;
    const Vec3 direction_turn = kRatio * turn + (kRatio * cos_turn - below_turn) * normal +
                                (kRatio * r.cos_in - r.cos_below) * normal_turn;
    return Vec3(on_surface + light.length_mm * direction_turn);
  };
  return std::abs(light.direction.dot(moved(first).cross(moved(second))));
}

}  // namespace

std::optional<UnscatteredLight> light_at(const ShapeGrid& shape, const Lamp& lamp,
                                         const Vec3& point_mm) {
  UnscatteredLight light;
  light.entry_mm = point_mm;
  Vec3 way;
  double distance_mm = 0;
  Refraction bent;
  // Where the ray comes through depends on how it is bent there: a fixed point, which each step
  // nears to the depth over the radius of curvature of what it was off by, a tenth or less.
  constexpr int kMostSteps = 12;
  constexpr double kNearEnoughMm = 1e-3;
  for (int i = 0;; ++i) {
    const Vec3 ray = light.entry_mm - lamp.center_mm;
    distance_mm = cv::norm(ray);
    way = ray / distance_mm;
    const ShapeGrid::Place place = shape.at(light.entry_mm);
    light.normal = place.normal;
    bent = refracted(way, light.normal);
    const double height_mm = place.distance_mm + light.normal.dot(point_mm - light.entry_mm);
    light.length_mm = height_mm / light.normal.dot(bent.direction);
    light.direction = bent.direction;
    const Vec3 entry_mm = point_mm - light.length_mm * bent.direction;
    const double moved_mm = cv::norm(entry_mm - light.entry_mm);
    light.entry_mm = entry_mm;
    if (moved_mm < kNearEnoughMm) break;
    if (i == kMostSteps || !(moved_mm < 10)) return std::nullopt;
  }
  if (bent.cos_in <= 1e-3 || light.length_mm <= 0) return std::nullopt;
  const double pencil = pencil_mm2_per_sr(shape, light, way, distance_mm, bent);
  if (!(pencil > 0)) return std::nullopt;
  light.irradiance =
      lamp.intensity_mm2 * (1 - fresnel_reflectance(bent.cos_in, 1, kSkinIndex)) / pencil;
  return light;
}

}  // namespace hw_sim
