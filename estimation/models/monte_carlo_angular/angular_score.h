// What a white run records of photons that enter from all directions, and the table made of it.
//
// Photons enter evenly over the disc of directions; every exit is projected onto DirectionPairs.
// Light that scattered once is left out and computed instead: exactly, by quadrature over the
// discs.
#pragma once

#include <array>
#include <complex>
#include <span>
#include <vector>

#include "estimation/models/monte_carlo/photon_walk.h"
#include "estimation/models/monte_carlo_angular/angular_table.h"

namespace estimation {

// The scores of one batch of photons. Not thread-safe: one per thread.
class AngularScore {
 public:
  static constexpr double kLongestPath_tmfp = 2000;
  // A path turned around the normal is as likely: each counts in so many azimuths. They cost less
  // than one more walk and, from k = sigma_s' on, are worth most of it.
  static constexpr std::size_t kTurns = 8;
  using Coefficients = std::array<double, DirectionPairs::kPairs>;

  AngularScore();

  // Photons of stream number `stream` of this seed; `walk` ends at kLongestPath_tmfp.
  void run(const PhotonWalk& walk, std::uint64_t seed, std::uint64_t stream,
           std::int64_t photon_count);
  void add(const AngularScore& other);

  std::int64_t photon_count() const { return photon_count_; }

  // Per photon, of light that scattered more than once, at a node of the table's grids.
  Coefficients multiple(int s_index, int k_index) const;

 private:
  void record(double eta, const PhotonExit& exit);
  static std::size_t at(std::size_t bin, int k_index) {
    return bin * static_cast<std::size_t>(kAngularGridK.node_count) +
           static_cast<std::size_t>(k_index);
  }

  // Of the photon under way, turned.
  std::array<DirectionPairs::Polynomials, kTurns> incidence_{};
  std::int64_t photon_count_ = 0;
  std::vector<Coefficients> sum_;  // [path length][k]
};

// G of light that scattered exactly once, real and imaginary part, in closed form:
//   G1 = pi p(cos Theta) sigma_s / (eta^2 [sigma_t (m_i + m_o) + i k (m_o a_x + m_i b_x)])
// a, b the directions of travel inside, m their cosines to the normal, p Henyey-Greenstein's.
std::complex<double> single_scattering(const WalkMedium& medium, double absorption, double k_tmfp,
                                       DiscPoint incidence, DiscPoint exit);

// `batches` hold equally many photons each, at least two; their scatter gives the standard errors.
// The caller fills program and seed.
AngularTable make_angular_table(const WalkMedium& medium, std::span<const AngularScore> batches);

}  // namespace estimation
