// Where a pixel's search starts: what its first harmonics say.
#pragma once

#include <array>
#include <complex>
#include <optional>

#include "estimation/profile/pixel_model.h"

namespace estimation {

// A point of the search. The mean R_d + B takes the place of B: it is linear, and independent of
// the rest.
struct SearchPoint {
  ShapePoint shape;
  double mean = 0;
  double phase_px = 0;
};

// The samples' mean, first and another harmonic by least squares, without weights:
// r = mean + sum Re[harmonic exp(i n angle)].
struct Demodulated {
  double mean = 0;
  std::complex<double> first{}, second{};
  double first_variance = 0;  // of its parts, for samples of unit variance
};

// Borrows a bound model.
class PixelStart {
 public:
  PixelStart(const FitProblem& problem, PixelModel& model);

  // nullopt: too few different shifts.
  std::optional<Demodulated> demodulate() const;

  // The phase from the first harmonic. R_d is a share of the mean, l_d what then gives the first
  // harmonic its height; where there may be indirect light, the share that gives the second its
  // own.
  SearchPoint from_harmonics(const Demodulated& data) const;

  // The same phase in the middle of what can be told apart.
  SearchPoint from_middle(const Demodulated& data) const;

 private:
  double envelope(int n) const;
  SearchPoint with_phase(const Demodulated& data) const;
  std::array<double, 2> first_harmonics(ShapePoint shape) const;
  double log_with_first_harmonic(double logit, double target) const;

  const FitProblem& problem_;
  PixelModel& model_;
  ShapeRange range_;  // of starts
  int second_ = 2;    // the harmonic that a start compares with the first
};

}  // namespace estimation
