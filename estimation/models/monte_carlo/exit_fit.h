// The exit radiance of a white run as the polynomial that a scattering table holds.
#pragma once

#include "estimation/models/monte_carlo/scattering_table.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {

// The flux, per photon, in bins of equal Lambertian flux (equal steps of the squared exit cosine).
using ExitFlux = std::array<double, ScoreGrid::kExitBinCount>;

// Of the light that scattered more than once, at absorption x = sigma_a/sigma_s'.
ExitFlux exit_flux(const WhiteScore& score, double absorption);

// Least squares of the bins' h against the form that ExitRadiance states; its hemispherical mean is
// 1 exactly.
class ExitFit {
 public:
  explicit ExitFit(double eta);
  ExitRadiance fit(const ExitFlux& flux) const;

 private:
  // The averages over each bin of (1 - F) v^j.
  std::array<std::array<double, 4>, ScoreGrid::kExitBinCount> shapes_{};
};

}  // namespace estimation
