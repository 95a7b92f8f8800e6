// From the scores of a white run to the table of one medium: the Laplace transform over path
// lengths.
//
// Exact where it can be. Light that scattered once is computed (SingleScattering). The flux at path
// lengths beyond kLawFrom_tmfp follows C L^(-3/2) (1 + a/L + b/L^2), fitted to the run under the
// condition that all light leaves in the end, so R_d -> 1 as x -> 0; beyond the longest path its
// phase average is diffusion's exp(-k^2 L/3), in closed form. Light that scattered more often, at
// absorptions or frequencies beyond the scores', is scaled from the last of them as twofold
// scattering does: it is a small part of R~ there.
#pragma once

#include <span>

#include "estimation/models/monte_carlo/scattering_table.h"
#include "estimation/models/monte_carlo/single_scattering.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {

// `batches` hold equally many photons each, at least two; their scatter gives the standard errors.
// The caller fills program and seed.
ScatteringTable make_scattering_table(const WalkMedium& medium,
                                      std::span<const WhiteScore> batches);

// R~ of one score at any absorption x and a scored frequency: what the table is made of and tested
// against.
class WhiteTransform {
 public:
  WhiteTransform(const WalkMedium& medium, const WhiteScore& score);

  // `absorption` up to kLargestAbsorption.
  double transform(double absorption, int frequency) const;
  // The same without what scattered only once.
  double multiple(double absorption, int frequency) const;
  double slope() const;

  static constexpr double kLargestAbsorption = 100;
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
