// A white Monte Carlo walk: photons in a medium that scatters and does not absorb. Absorption comes
// afterwards, as exp(-x L) over each exit's path length L, so one run serves every absorption.
//
// Lengths are in transport mean free paths 1/sigma_s' (suffix _tmfp), so sigma_s = 1/(1 - g), and
// x = sigma_a/sigma_s'. The medium fills z > 0 down to its thickness; above and below is air. At
// the boundary the exact unpolarised Fresnel part of the weight leaves and is reported, the rest
// goes on. Source: Wang, Jacques and Zheng, MCML (1995); written anew.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>

#include "estimation/models/monte_carlo/random_stream.h"

namespace estimation {

struct Direction3 {
  double x = 0, y = 0, z = 1;  // unit vector; z > 0 points into the medium
};

// The part of unpolarised light that the boundary reflects back into the medium.
//   cos_inside   of the angle to the normal, 0..1
//   cos_outside  what it becomes outside; 0 at total reflection
struct Reflection {
  double reflected_frac = 1;
  double cos_outside = 0;
};
Reflection inner_reflection(double eta, double cos_inside);

// The direction inside of light that arrives from the air with this cosine to the normal, azimuth 0
// being +x (the direction in which the light travels, so it comes from -x).
Direction3 refracted_into(double eta, double cos_incidence, double azimuth_rad);

// The fraction of unpolarised light that enters the medium from the air at this angle: 1 - F.
double transmitted_frac(double eta, double cos_incidence);

struct WalkMedium {
  double eta = 1.4;         // refractive index relative to the air on both sides, >= 1
  double anisotropy = 0.8;  // g of the Henyey-Greenstein phase function, -1 < g < 1
  double thickness_tmfp = std::numeric_limits<double>::infinity();
};

struct WalkLimits {
  double longest_path_tmfp = 1000;  // walks end here; what is left is returned
  // From this path length on, every further factor of 4 halves the number of walks and doubles
  // their weight (Russian roulette: unbiased): long paths take most of the time and matter least.
  double roulette_path_tmfp = std::numeric_limits<double>::infinity();
};

struct PhotonExit {
  double x_tmfp, y_tmfp;  // from the point of entry
  Direction3 inside;      // of travel, before the boundary
  double cos_outside;     // to the outward normal; outside.x, .y = eta * inside.x, .y
  double path_tmfp;       // inside the medium, since the launch
  double weight;          // of the photon's 1 that leaves here
  std::int64_t scatter_count;
  bool through_bottom;  // left at z = thickness
};

class PhotonWalk {
 public:
  PhotonWalk(const WalkMedium& medium, const WalkLimits& limits);

  const WalkMedium& medium() const { return medium_; }
  const WalkLimits& limits() const { return limits_; }

  // One photon from the origin, just inside, in `direction` (z > 0). Calls
  // exit(const PhotonExit&) wherever a part of it leaves, in order of path length.
  // Returns the weight that was still inside at the longest path. Const: one walk serves any number
  // of threads, each with its own stream.
  template <typename Visitor>
  double launch(const Direction3& direction, RandomStream& random, Visitor&& exit) const;

 private:
  struct Photon {
    double x = 0, y = 0, z = 0;
    Direction3 direction;
    double path_tmfp = 0, weight = 1;
    std::int64_t scatter_count = 0;
    double usual_weight = 1;  // what roulette aims for at this path length
    double roulette_path_tmfp;
  };

  // A free path of mean 1/sigma_s.
  double free_path(RandomStream& random) const {
    // The float logarithm is several times faster, and 23 bits of a free path are plenty.
    const float u = (static_cast<float>(random.bits() >> 41) + 0.5F) * 0x1p-23F;
    return -mean_free_path_tmfp_ * static_cast<double>(std::log(u));
  }
  double scattering_cosine(RandomStream& random) const {
    const double u = random.uniform();
    if (medium_.anisotropy == 0) return 2 * u - 1;
    const double ratio = one_minus_g2_ / (1 - medium_.anisotropy + 2 * medium_.anisotropy * u);
    return (one_plus_g2_ - ratio * ratio) * half_over_g_;
  }
  void scatter(Photon& photon, RandomStream& random) const;
  void advance(Photon& photon, double length) const {
    photon.x += length * photon.direction.x;
    photon.y += length * photon.direction.y;
    photon.z += length * photon.direction.z;
    photon.path_tmfp += length;
  }
  // Kills or strengthens, keeping the expected weight. False: the walk is over.
  bool roulette(Photon& photon, RandomStream& random) const;
  template <typename Visitor>
  bool cross_boundaries(Photon& photon, double& length, RandomStream& random, Visitor& exit) const;

  WalkMedium medium_;
  WalkLimits limits_;
  double mean_free_path_tmfp_, one_minus_g2_, one_plus_g2_, half_over_g_;
};

inline void PhotonWalk::scatter(Photon& photon, RandomStream& random) const {
  const double cosine = scattering_cosine(random);
  // A point in the unit disc gives an azimuth without sines.
  double a, b, square;
  do {
    const std::uint64_t bits = random.bits();
    a = static_cast<double>(static_cast<std::int32_t>(bits >> 32)) + 0.5;
    b = static_cast<double>(static_cast<std::int32_t>(bits & 0xffffffffu)) + 0.5;
    square = a * a + b * b;
  } while (square > 0x1p62);
  const double sine_over_radius = std::sqrt(std::fmax(0, 1 - cosine * cosine) / square);
  a *= sine_over_radius;
  b *= sine_over_radius;
  // Orthonormal basis around the direction without square roots (Duff et al., JCGT 2017).
  const Direction3 d = photon.direction;
  const double sign = std::copysign(1.0, d.z);
  const double p = -1 / (sign + d.z);
  const double q = d.x * d.y * p;
  Direction3 next = {a * (1 + sign * d.x * d.x * p) + b * q + cosine * d.x,
                     a * sign * q + b * (sign + d.y * d.y * p) + cosine * d.y,
                     -a * sign * d.x - b * d.y + cosine * d.z};
  // One Newton step keeps the length at 1 over any number of rotations.
  const double correction = 1.5 - 0.5 * (next.x * next.x + next.y * next.y + next.z * next.z);
  photon.direction = {next.x * correction, next.y * correction, next.z * correction};
  ++photon.scatter_count;
}

inline bool PhotonWalk::roulette(Photon& photon, RandomStream& random) const {
  while (photon.path_tmfp > photon.roulette_path_tmfp) {
    photon.roulette_path_tmfp *= 4;
    photon.usual_weight *= 2;
    if (random.bits() >> 63 != 0) return false;
    photon.weight *= 2;
  }
  // After a boundary only a few percent may go on: not worth a walk of its own each time.
  if (photon.weight < 0.25 * photon.usual_weight) {
    if (random.uniform() * photon.usual_weight > photon.weight) return false;
    photon.weight = photon.usual_weight;
  }
  return true;
}

// Reports and reflects while the path of `length` ahead leads out; shortens it to what is left.
// False: the walk is over.
template <typename Visitor>
bool PhotonWalk::cross_boundaries(Photon& photon, double& length, RandomStream& random,
                                  Visitor& exit) const {
  for (;;) {
    const double z_ahead = photon.z + length * photon.direction.z;
    const bool through_bottom = z_ahead > medium_.thickness_tmfp;
    if (z_ahead >= 0 && !through_bottom) return true;
    const double boundary = through_bottom ? medium_.thickness_tmfp : 0;
    const double there = (boundary - photon.z) / photon.direction.z;
    if (photon.path_tmfp + there > limits_.longest_path_tmfp) return true;
    advance(photon, there);
    photon.z = boundary;
    length -= there;
    const Reflection mirror = inner_reflection(medium_.eta, std::abs(photon.direction.z));
    if (mirror.reflected_frac < 1) {
      const double leaving = photon.weight * (1 - mirror.reflected_frac);
      exit(PhotonExit{photon.x, photon.y, photon.direction, mirror.cos_outside, photon.path_tmfp,
                      leaving, photon.scatter_count, through_bottom});
      photon.weight -= leaving;
      if (photon.weight <= 0 || !roulette(photon, random)) return false;
    }
    photon.direction.z = -photon.direction.z;
  }
}

template <typename Visitor>
double PhotonWalk::launch(const Direction3& direction, RandomStream& random, Visitor&& exit) const {
  Photon photon;
  photon.direction = direction;
  photon.roulette_path_tmfp = limits_.roulette_path_tmfp;
  for (;;) {
    double length = free_path(random);
    if (!cross_boundaries(photon, length, random, exit)) return 0;
    advance(photon, length);
    if (photon.path_tmfp > limits_.longest_path_tmfp) return photon.weight;
    if (!roulette(photon, random)) return 0;
    scatter(photon, random);
  }
}

}  // namespace estimation
