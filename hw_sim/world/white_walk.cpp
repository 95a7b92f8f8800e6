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
