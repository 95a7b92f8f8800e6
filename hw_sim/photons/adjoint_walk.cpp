#include "hw_sim/photons/adjoint_walk.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace hw_sim {

using estimation::Vec3;

namespace {

// A path this dim goes on by chance.
constexpr double kDim = 0.1;
// No absorption and no bottom: such a path may never come back. Beyond, it is given up.
constexpr int kMostCollisions = 1'000'000;
// A shape's distance may exceed the true one inside by that factor (hw_sim/world/shape.h: close to
// a distance near the surface).
constexpr double kSafeShare = 0.5;
// A flight is looked at in pieces of that length where the surface is near: chords of a hollow of
// 2 mm radius that stay unseen are less than 6 um deep.
constexpr double kPieceMm = 0.3;
constexpr double kOnSurfaceMm = 1e-6;
// Optical depth from which the lamp's unscattered light is asked for by chance.
constexpr double kDeepTau = 0.5;

double phase_per_sr(double g, double cosine) {
  const double base = 1 + g * g - 2 * g * cosine;
  return (1 - g * g) / (4 * std::numbers::pi * base * std::sqrt(base));
}

}  // namespace

struct AdjointWalk::Photon {
  Vec3 point_mm, way;
  double weight = 0;
  double safe_mm = 0;  // the surface is farther than that
};

std::optional<PathStart> entering(const ShapeGrid& shape, const Vec3& point_mm, const Vec3& way) {
  const Vec3 on_surface = shape.on_surface(point_mm);
  const Vec3 normal = shape.normal(on_surface);
  const double cosine = -way.dot(normal);
  if (cosine <= 0) return std::nullopt;
  constexpr double kRatio = 1 / kSkinIndex;
  const double cos_below = std::sqrt(1 - kRatio * kRatio * (1 - cosine * cosine));
  return PathStart{.point_mm = on_surface - kOnSurfaceMm * normal,
                   .way = kRatio * way + (kRatio * cosine - cos_below) * normal,
                   .weight = 1 - fresnel_reflectance(cosine, 1, kSkinIndex)};
}

std::optional<PathStart> seen_path(const ShapeGrid& shape, const Vec3& point_mm,
                                   const Vec3& towards_eye) {
  auto start = entering(shape, point_mm, -towards_eye);
  // Radiance over the index squared is what a ray keeps; pi makes it a reflectance factor.
  if (start) start->weight *= std::numbers::pi / (kSkinIndex * kSkinIndex);
  return start;
}

PathEnd AdjointWalk::trace(const PathStart& start, PhotonRandom& random,
                           std::vector<Deposit>& deposits, PathWatcher* watcher) const {
  Photon photon{start.point_mm, start.way, start.weight};
  const double greatest = matter_.greatest_sigma_t_per_mm();
  for (int i = 0; i < kMostCollisions; ++i) {
    if (!fly(photon, random)) return {photon.point_mm, photon.way, photon.weight};
    const VolumeOptics here = matter_.at(photon.point_mm);
    if (random.uniform() * greatest > here.sigma_t_per_mm()) continue;  // nothing was there
    photon.weight *= here.sigma_s_per_mm / here.sigma_t_per_mm();
    if (photon.weight < kDim * start.weight) {
      if (random.uniform() * kDim * start.weight > photon.weight) return {};
      photon.weight = kDim * start.weight;
    }
    collect(photon, here, random, deposits);
    const std::array<double, 3> way =
        deflected({photon.way[0], photon.way[1], photon.way[2]},
                  henyey_greenstein_cosine(here.anisotropy, random), random);
    const Vec3 way_before = photon.way;
    photon.way = {way[0], way[1], way[2]};
    if (!watcher) continue;
    photon.weight *=
        watcher->on_turn({photon.point_mm, way_before, photon.way, here.anisotropy, photon.weight});
    if (photon.weight == 0) return {};
  }
  return {};
}

// To the next place where something may be; false when the photon has left.
bool AdjointWalk::fly(Photon& photon, PhotonRandom& random) const {
  double left_mm = -std::log(random.uniform()) / matter_.greatest_sigma_t_per_mm();
  while (left_mm > photon.safe_mm) {
    const double step_mm = std::min(left_mm, std::max(photon.safe_mm, kPieceMm));
    const Vec3 next = photon.point_mm + step_mm * photon.way;
    const double distance = shape_.distance_mm(next);
    if (distance < 0) {
      photon.point_mm = next;
      photon.safe_mm = -kSafeShare * distance;
      left_mm -= step_mm;
    } else {
      double flown_mm = 0;
      if (!meet_boundary(photon, step_mm, random, flown_mm)) return false;
      left_mm -= flown_mm;
    }
  }
  photon.point_mm += left_mm * photon.way;
  photon.safe_mm -= left_mm;
  return true;
}

// The surface lies within `reach_mm`: to it, and back by chance. False when the photon has left.
bool AdjointWalk::meet_boundary(Photon& photon, double reach_mm, PhotonRandom& random,
                                double& flown_mm) const {
  double inner = 0, outer = reach_mm;
  double below = std::min(shape_.distance_mm(photon.point_mm), -1e-12);
  double above = shape_.distance_mm(photon.point_mm + outer * photon.way);
  double kept = 0;  // the side that stayed: its value is halved, so that both sides close in
  for (int i = 0; i < 40 && outer - inner > kOnSurfaceMm / 10; ++i) {
    const double middle = inner + (outer - inner) * below / (below - above);
    const double value = shape_.distance_mm(photon.point_mm + middle * photon.way);
    if (std::abs(value) < kOnSurfaceMm) {
      inner = middle;
      break;
    }
    if (value < 0) {
      inner = middle;
      below = value;
      if (kept > 0) above /= 2;
      kept = 1;
    } else {
      outer = middle;
      above = value;
      if (kept < 0) below /= 2;
      kept = -1;
    }
  }
  photon.point_mm += inner * photon.way;
  photon.safe_mm = 0;
  flown_mm = inner;
  const auto [distance_mm, normal] = shape_.at(photon.point_mm);
  const double cosine = photon.way.dot(normal);
  photon.point_mm -= (distance_mm + kOnSurfaceMm) * normal;
  if (cosine <= 0) return true;  // it grazes a hollow: pushed clear of it
  const double reflected = fresnel_reflectance(cosine, kSkinIndex, 1);
  if (random.uniform() > reflected) {
    const double cos_outside =
        std::sqrt(std::max(0.0, 1 - kSkinIndex * kSkinIndex * (1 - cosine * cosine)));
    photon.way = kSkinIndex * photon.way + (cos_outside - kSkinIndex * cosine) * normal;
    return false;
  }
  photon.way -= 2 * cosine * normal;
  return true;
}

void AdjointWalk::collect(const Photon& photon, const VolumeOptics& here, PhotonRandom& random,
                          std::vector<Deposit>& deposits) const {
  const double depth_mm = std::max(photon.safe_mm / kSafeShare, 0.0);
  double weight = photon.weight;
  const double too_deep = depth_mm * here.sigma_t_per_mm() - kDeepTau;
  if (too_deep > 0) {
    const double chance = std::exp(-too_deep);
    if (random.uniform() > chance) return;
    weight /= chance;
  }
  const auto light = light_at(shape_, lamp_, photon.point_mm);
  if (!light) return;
  const double sigma_t = matter_.at(0.5 * (photon.point_mm + light->entry_mm)).sigma_t_per_mm();
  const double scattered = phase_per_sr(here.anisotropy, -light->direction.dot(photon.way));
  deposits.push_back(
      {light->entry_mm, light->normal,
       weight * scattered * light->irradiance * std::exp(-sigma_t * light->length_mm)});
}

}  // namespace hw_sim
