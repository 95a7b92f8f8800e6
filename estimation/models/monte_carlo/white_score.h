// What a white run records of its photons: for every path length, how much leaves, how far from the
// entry, and in which direction.
#pragma once

#include <vector>

#include "estimation/models/monte_carlo/photon_walk.h"

namespace estimation {

// The spatial frequencies and path lengths at which the scores are kept; units of 1/sigma_s'.
//
// Frequencies: 0 and a grid uniform in asinh(k/kGridScale): log-spaced above, even at 0.
// Path lengths: one bin up to the shortest, then kBinsPerDecade in every factor of ten.
struct ScoreGrid {
  static constexpr double kGridScale = 0.01, kGridStep = 0.2;
  static constexpr int kFrequencyCount = 51;  // up to k/sigma_s' = 110
  static constexpr double kShortestPath_tmfp = 1e-4, kLongestPath_tmfp = 2000;
  static constexpr int kBinsPerDecade = 64;
  static constexpr int kExitBinCount =
      24;  // in the square of the exit cosine: equal Lambertian flux

  static double k_tmfp(int index);
  static int path_bin_count();
  static double path_begin_tmfp(int bin);  // bin = path_bin_count() gives the end of the last

  // How many of the frequencies matter at this path length. What is left out has an expectation
  // below exp(-20): phase averages over a path decay like exp(-min(1, k^2/3) L) or faster, the
  // decay of the diffusion mode where there is one, of the ballistic light where there is none.
  static int frequencies_at(double path_tmfp);
};

// The scores of one batch of photons. Not thread-safe: one per thread.
class WhiteScore {
 public:
  WhiteScore();

  // Photons that enter at normal incidence, number `stream` of this seed.
  void run(const PhotonWalk& walk, std::uint64_t seed, std::uint64_t stream,
           std::int64_t photon_count);
  void add(const WhiteScore& other);

  std::int64_t photon_count() const { return photon_count_; }
  // Weight still inside at the longest path.
  double weight_left() const { return weight_left_; }
  // Sum of weight times J_0(k r), and of that times (L - middle of the bin): exits after two or
  // more scatterings; what leaves after one is known exactly (SingleScattering).
  double sum(int bin, int frequency) const { return sum_[at(bin, frequency)]; }
  double moment(int bin, int frequency) const { return moment_[at(bin, frequency)]; }
  double exit_weight(int bin, int exit_bin) const { return exit_[exit_at(bin, exit_bin)]; }
  double single_weight() const { return single_weight_; }

 private:
  void record(const PhotonExit& exit);
  static std::size_t at(int bin, int frequency) {
    return static_cast<std::size_t>(bin) * ScoreGrid::kFrequencyCount +
           static_cast<std::size_t>(frequency);
  }
  static std::size_t exit_at(int bin, int exit_bin) {
    return static_cast<std::size_t>(bin) * ScoreGrid::kExitBinCount +
           static_cast<std::size_t>(exit_bin);
  }

  std::int64_t photon_count_ = 0;
  double weight_left_ = 0, single_weight_ = 0;
  std::vector<double> sum_, moment_, exit_;
};

// The Bessel function of the first kind, order 0, to 1e-6: a good deal faster than
// std::cyl_bessel_j.
double bessel_j0(double z);

}  // namespace estimation
