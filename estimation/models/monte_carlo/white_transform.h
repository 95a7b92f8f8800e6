// From the scores of a white run to R~: the Laplace transform over path lengths.
//
// Light that scattered once is computed (SingleScattering). The flux at path lengths beyond
// kLawFrom_tmfp follows C L^(-3/2) (1 + a/L + b/L^2), fitted to the run under the condition that
// all light leaves in the end, so R_d -> 1 as x -> 0; beyond the longest path its phase average is
// diffusion's exp(-k^2 L/3), in closed form.
#pragma once

#include <array>
#include <vector>

#include "estimation/models/monte_carlo/single_scattering.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {

// R~ of one score at any absorption x = sigma_a/sigma_s' and the scored frequencies.
class WhiteTransform {
 public:
  WhiteTransform(const WalkMedium& medium, const WhiteScore& score);

  double transform(double absorption, int frequency) const;
  // The same without what scattered only once.
  double multiple(double absorption, int frequency) const;
  // 1 - R~ -> slope * sqrt(3 x + k^2) at the origin.
  double slope() const;

  static constexpr double kLawFrom_tmfp = 150;

 private:
  struct Bin {
    double middle_tmfp, width_tmfp;
  };
  void fit_law(double mass_beyond);
  double tail(double decay) const;

  SingleScattering single_;
  std::vector<Bin> bins_;
  std::vector<double> sum_, moment_;  // per photon, [bin][frequency]
  std::array<double, 3> law_{};       // C, C a, C b
};

}  // namespace estimation
