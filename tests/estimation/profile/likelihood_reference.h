// The joint maximum likelihood fit once more: in long double, plain and slow, from
// design/estimation.md alone. Nothing of the estimator's models, tables, optimisers or noise rules
// is used; only its data types.
#pragma once

#include <array>
#include <complex>
#include <optional>
#include <vector>

#include "estimation/radiometry/noise.h"

namespace estimation::testing {

using Real = long double;

// A pixel's sweep as the fit sees it; the dipole's material by R_d and l_d.
struct ReferencePixel {
  int period_px = 40, width_px = 8;
  std::vector<Real> shifts_px{};  // offsets included
  Real black_frac = 0;
  Real position_px = 0;
  Real full_signal = 1;
  std::vector<std::complex<Real>> factors{};  // f_0, f_1 ...; empty: 1
  std::vector<MergedNoise> noise{};
  Real eta = 1.4L;
};

struct ReferencePoint {
  Real logit = 0, log_translucency_px = 0, indirect = 0, phase_px = 0;
};

// Signals at the shifts, DN/us, as many harmonics as it takes.
std::vector<Real> reference_signals(const ReferencePixel& pixel, const ReferencePoint& point);

// The variance of a merged signal.
Real reference_variance(const ReferencePixel& pixel, Real signal);

struct ReferenceFit {
  ReferencePoint point;
  std::array<Real, 4> sd{};  // of t, ln l, B, phase
  std::array<Real, 10> covariance{};
  Real chi_square = 0;
};

// Iteratively reweighted least squares from `start` until nothing changes; nullopt if that never
// happens.
//   samples  DN/us at the shifts; NaN: lost
std::optional<ReferenceFit> reference_fit(const ReferencePixel& pixel,
                                          const std::vector<float>& samples,
                                          const ReferencePoint& start, bool is_indirect_free);

}  // namespace estimation::testing
