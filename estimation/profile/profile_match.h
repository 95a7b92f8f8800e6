// One pixel's scattering profile against the table: the error metric, and the one-dimensional
// search along the row of its R_d (the paper's section 5.1).
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "estimation/profile/profile_table.h"
#include "estimation/profile/stripe_set.h"

namespace estimation {

// Where a search ended.
struct ProfileMatch {
  double col = 0;           // of the table, between columns
  double cost = 0;          // sum of squared differences at the best column
  double curvature = 0;     // second derivative of the cost by column
  bool is_at_edge = false;  // the best profile lies outside the table: no match
};

// Holds one pixel at a time; one matcher per thread and stripe set. Any set of shifts. Evenly
// spaced ones (the paper's 40) are compared as harmonics, which by Parseval is the same sum of
// squares at a fifth of the price; others sample by sample.
class ProfileMatcher {
 public:
  enum class Metric { kFastest, kSamples };  // kSamples: never the harmonics, for comparison
  ProfileMatcher(const StripeSet& stripes, int greatest_harmonic_count,
                 Metric metric = Metric::kFastest);

  // Takes a pixel.
  //   samples      [shift] on any linear scale, finite
  //   position_px  the pixel's projector coordinate along the stripes' axis
  //   contrast     [harmonic] m_n of the optics, greatest_harmonic_count of them
  void load(std::span<const double> samples, double position_px, std::span<const float> contrast);

  // Sum over shifts of the squared difference between the pixel's profile less `offset` and the
  // table's, both divided by their means. `row` may lie between rows. Needs offset < mean().
  double cost(const ProfileTable& table, double row, int col, double offset);

  // The least cost along `row`. A first search scans the row coarsely, then closes in with
  // parabolas through three columns; `from_col` >= 0 starts there instead (a second match is close
  // by).
  ProfileMatch search(const ProfileTable& table, double row, double offset, double from_col = -1);

  std::size_t sample_count() const { return shifts_px_.size(); }
  double mean() const { return mean_; }  // of the samples

  // The matched profile of area one at the sampled shifts.
  struct Curve {
    // The minima of the matched and of the input curve, both as the mean over the darkest eighth of
    // the matched curve's shifts: the least of 40 noisy samples would lie too low.
    double trough = 0;             // relative to the matched samples' mean
    double trough_of_samples = 0;  // on the scale of the samples
    double mean = 0;  // of the samples, relative to the mean over all phases (1 for a full sweep)
  };
  Curve curve(const ProfileTable& table, double row, double col);

 private:
  void mix_harmonics(const ProfileTable& table, double row, int col);
  void predict_samples();
  double cost_of_harmonics(double offset);
  double cost_of_samples(double offset);

  StripeShape shape_;
  std::vector<int> shifts_px_;
  std::size_t harmonic_count_ = 0;
  bool is_even_ = false;         // evenly spaced: harmonics
  std::size_t bin_count_ = 0;    // discrete frequencies 0..S/2
  std::vector<double> bin_cos_;  // [bin][shift]
  std::vector<double> bin_sin_;
  std::vector<std::size_t> bin_of_;  // [n - 1] where harmonic n appears when sampled
  std::vector<double> bin_weight_;   // [bin] of its squared magnitude in the sum over samples

  std::vector<double> samples_;
  double mean_ = 0;
  std::vector<double> data_re_, data_im_;    // [bin]
  std::vector<double> basis_re_, basis_im_;  // [n - 1] (uneven: [shift][n - 1]) m_n times its phase
  std::vector<double> harmonics_;            // the profile last mixed
  std::vector<double> predicted_;            // [shift]
  std::vector<double> model_re_, model_im_;  // [bin]
};

}  // namespace estimation
