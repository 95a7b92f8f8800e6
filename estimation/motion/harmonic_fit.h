// Light as a sum of harmonics of the stripes' shift, fitted at each place over the frames of a
// sweep. Private to estimation/motion.
#pragma once

#include <complex>
#include <cstddef>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

namespace estimation {

inline constexpr int kShiftHarmonics = 3;

// Least squares over the frames, the same for all places.
class HarmonicFit {
 public:
  // Of all frames but `without`.
  HarmonicFit(const std::vector<double>& phases_rad, std::optional<std::size_t> without);

  bool is_solved() const { return is_solved_; }
  int term_count() const { return term_count_; }
  double term(int frame, int term) const { return design_(frame, term); }
  // How much of a frame's own light its fit follows.
  double leverage(int frame) const;
  // [term][place] of light as [frame][place].
  std::vector<std::vector<float>> coefficients(
      const std::vector<std::vector<float>>& light_dn) const;

 private:
  static constexpr double kLeastCondition = 1e-3;  // of an inversion by SVD: smallest over largest
  const int frame_count_, term_count_;
  cv::Mat1d design_, inverse_;
  bool is_solved_ = false;
};

// Of the first harmonic with the mean over all places: 0 for places all over the period, 1 for one.
double coherence(const std::vector<std::vector<float>>& coefficients);

// The square of the first harmonic, of what noise as large as the fit leaves would make of it.
double signal_of(const HarmonicFit& fit, const std::vector<std::vector<float>>& coefficients,
                 const std::vector<std::vector<float>>& light_dn);

// Of a frame's light, relative to what the fit has for its shift: 1 is right; the argument is the
// phase by which it is ahead, the size its modulation.
std::complex<double> phasor_of(const HarmonicFit& fit,
                               const std::vector<std::vector<float>>& coefficients,
                               const std::vector<float>& light_dn, int frame);

}  // namespace estimation
