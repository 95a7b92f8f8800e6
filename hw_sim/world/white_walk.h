// The simulator's own white Monte Carlo: photons through a half space that scatters and does not
// absorb; absorption is exp(-sigma_a L) over the path length L afterwards. Lengths in units of
// 1 / sigma_s'. Henyey-Greenstein with g 0.8, refractive index 1.4, exact unpolarised Fresnel
// boundary. Shares nothing with the estimator's program: two that agree are evidence.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace hw_sim {

inline constexpr double kSkinIndex = 1.4;
inline constexpr double kSkinAnisotropy = 0.8;

// Reflectance of the boundary for unpolarised light, from the medium `from` into the medium `into`;
// 1 beyond the critical angle.
double fresnel_reflectance(double cos_from, double from_index, double into_index);

// xoshiro256+, seeded by splitmix64: a stream of its own for each strand of photons.
class PhotonRandom {
 public:
  explicit PhotonRandom(std::uint64_t seed);
  // In (0, 1].
  double uniform() { return (static_cast<double>(next() >> 11) + 1) * 0x1p-53; }

 private:
  std::uint64_t next() {
    const std::uint64_t result = state_[0] + state_[3], t = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= t;
    state_[3] = (state_[3] << 45) | (state_[3] >> 19);
    return result;
  }
  std::array<std::uint64_t, 4> state_{};
};

// Henyey and Greenstein's phase function: the cosine of a scattering's deflection.
inline double henyey_greenstein_cosine(double g, PhotonRandom& random) {
  const double cosine = 2 * random.uniform() - 1;
  if (g == 0) return cosine;
  const double part = (1 - g * g) / (1 + g * cosine);
  return (1 + g * g - part * part) / (2 * g);
}

// A unit direction deflected by `cosine` about a random azimuth; a unit vector to rounding.
inline std::array<double, 3> deflected(const std::array<double, 3>& direction, double cosine,
                                       PhotonRandom& random) {
  const auto [u, v, w] = direction;
  double a = 0, b = 0, square = 2;
  while (square > 1 || square == 0) {  // a random azimuth without trigonometry
    a = 2 * random.uniform() - 1;
    b = 2 * random.uniform() - 1;
    square = a * a + b * b;
  }
  const double scale = std::sqrt(std::max(0.0, 1 - cosine * cosine) / square);
  a *= scale;
  b *= scale;
  // Duff et al., "Building an Orthonormal Basis, Revisited" (2017): no square root, no pole.
  const double sign = std::copysign(1.0, w);
  const double p = -1 / (sign + w), q = u * v * p;
  const double x = a * (1 + sign * u * u * p) + b * q + cosine * u;
  const double y = a * sign * q + b * (sign + v * v * p) + cosine * v;
  const double z = -a * sign * u - b * v + cosine * w;
  // Rounding must not add up over thousands of turns: Newton's step to unit length.
  const double norm = 1.5 - 0.5 * (x * x + y * y + z * z);
  return {norm * x, norm * y, norm * z};
}

// Where a photon leaves, and with how much of its weight.
struct PhotonExit {
  double x = 0, y = 0;                      // from where it entered; x along its way in
  double cos_exit = 1;                      // outside
  double cos_azimuth = 1, sin_azimuth = 0;  // of its direction, from x
  double path_length = 0;
  double weight = 0;
};

struct Walk {
  // Paths beyond carry less than exp(-6) at the least absorption that is tabulated.
  static constexpr double kLongest = 8000;
  // This deep the direction of the last few flights no longer matters: isotropic scattering with
  // the same sigma_s' (similarity) takes a fifth of the steps.
  static constexpr double kDeep = 6;

  double x = 0, y = 0, z = 0;  // z into the medium
  double u = 0, v = 0, w = 1;  // direction
  double length = 0;
  double weight = 1;
  bool is_deep = false;

  // Long paths are most of the work and little of the light: from kThinned on, of each octave as
  // many go on as makes the noise least for the time, at more weight. Light that comes out after a
  // path of L is as L^-3/2 and light still inside as L^-1/2, so those kept should be as L^-1/2.
  static constexpr double kThinned = 2;
  static constexpr double kKept = 0.70710678118654752;
  double next_thinning = kThinned;
  bool survives(PhotonRandom& random) {
    if (length < next_thinning) return true;
    next_thinning *= 2;
    weight /= kKept;
    return random.uniform() < kKept;
  }

  // To the next scattering; false when the photon is gone.
  template <typename Use>
  bool fly(PhotonRandom& random, const Use& on_exit) {
    while (true) {
      is_deep = z > kDeep || (z == kDeep && w > 0);
      const double flight = -std::log(random.uniform()) * (is_deep ? 1 : 1 - kSkinAnisotropy);
      const double end = z + flight * w;
      if (end < 0) {
        advance(-z / w, 0);
        const double reflected = fresnel_reflectance(-w, kSkinIndex, 1);
        if (reflected < 1) {
          on_exit(leaving(1 - reflected));
          // The rest goes on by chance at full weight: no walk is spent on a remnant.
          if (random.uniform() > reflected) return false;
        }
        w = -w;
      } else if (is_deep ? end < kDeep : end > kDeep) {
        advance((kDeep - z) / w, kDeep);  // free flights have no memory: begin anew beyond
      } else {
        advance(flight, end);
        return length < kLongest;
      }
      if (length >= kLongest) return false;
    }
  }

  void scatter(PhotonRandom& random) {
    const double cosine = henyey_greenstein_cosine(is_deep ? 0 : kSkinAnisotropy, random);
    const std::array<double, 3> turned = deflected({u, v, w}, cosine, random);
    u = turned[0];
    v = turned[1];
    w = turned[2];
  }

 private:
  void advance(double distance, double new_z) {
    x += distance * u;
    y += distance * v;
    z = new_z;
    length += distance;
  }
  PhotonExit leaving(double share) const;
};

// One photon that enters at the origin under `incidence_rad` (outside), its way in along +x: calls
// on_exit for each exit. All the weights of a photon sum to 1 in the mean, but for its absorption
// and the paths beyond Walk::kLongest.
template <typename Use>
void walk_photon(double incidence_rad, PhotonRandom& random, const Use& on_exit) {
  Walk walk;
  walk.u = std::sin(incidence_rad) / kSkinIndex;
  walk.w = std::sqrt(1 - walk.u * walk.u);
  while (walk.fly(random, on_exit) && walk.survives(random)) walk.scatter(random);
}

}  // namespace hw_sim
