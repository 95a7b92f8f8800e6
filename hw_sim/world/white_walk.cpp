#include "hw_sim/world/white_walk.h"

#include <algorithm>

namespace hw_sim {

double fresnel_reflectance(double cos_from, double from_index, double into_index) {
  const double ratio = from_index / into_index;
  const double sin2_into = ratio * ratio * (1 - cos_from * cos_from);
  if (sin2_into >= 1) return 1;
  const double cos_into = std::sqrt(1 - sin2_into);
  const double parallel = (into_index * cos_from - from_index * cos_into) /
                          (into_index * cos_from + from_index * cos_into);
  const double across = (from_index * cos_from - into_index * cos_into) /
                        (from_index * cos_from + into_index * cos_into);
  return 0.5 * (parallel * parallel + across * across);
}

PhotonRandom::PhotonRandom(std::uint64_t seed) {
  for (std::uint64_t& word : state_) {
    seed += 0x9E3779B97F4A7C15U;
    std::uint64_t mixed = seed;
    mixed = (mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9U;
    mixed = (mixed ^ (mixed >> 27)) * 0x94D049BB133111EBU;
    word = mixed ^ (mixed >> 31);
  }
}

std::array<double, 3> deflected(const std::array<double, 3>& direction, double cosine,
                                PhotonRandom& random) {
  auto [u, v, w] = direction;
  const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
  double a = 0, b = 0, square = 2;
  while (square > 1 || square == 0) {  // a random azimuth without trigonometry
    a = 2 * random.uniform() - 1;
    b = 2 * random.uniform() - 1;
    square = a * a + b * b;
  }
  const double scale = sine / std::sqrt(square);
  a *= scale;
  b *= scale;
  const double across2 = u * u + v * v;
  if (across2 < 1e-12) {
    u = a;
    v = b;
    w = w > 0 ? cosine : -cosine;
  } else {
    const double across = std::sqrt(across2);
    const double new_u = (a * u * w - b * v) / across + u * cosine;
    const double new_v = (a * v * w + b * u) / across + v * cosine;
    w = -a * across + w * cosine;
    u = new_u;
    v = new_v;
  }
  // Rounding must not add up over thousands of turns.
  const double norm = 1 / std::sqrt(u * u + v * v + w * w);
  u *= norm;
  v *= norm;
  w *= norm;
  return {u, v, w};
}

PhotonExit Walk::leaving(double share) const {
  const double sine = std::hypot(u, v);
  const double sine_outside = kSkinIndex * sine;
  return {.x = x,
          .y = y,
          .cos_exit = std::sqrt(std::max(0.0, 1 - sine_outside * sine_outside)),
          .cos_azimuth = sine > 0 ? u / sine : 1,
          .sin_azimuth = sine > 0 ? v / sine : 0,
          .path_length = length,
          .weight = weight * share};
}

}  // namespace hw_sim
