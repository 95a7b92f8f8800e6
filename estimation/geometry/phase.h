// The first harmonic of a pixel's signal over shifted stripes or fringes: its phase is the
// projector coordinate modulo the period.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "estimation/session/pattern.h"

namespace estimation {

// Patterns that differ in their shift alone.
struct PhaseFamily {
  Axis axis = Axis::kColumn;
  double period_px = 0;
  int width_px = 0;  // lit columns of a stripe; 0: a fringe
  std::vector<double> shift_px;

  // The coordinate at which the signal over shifts peaks for shift 0: stripes lit at
  // 0 .. width - 1 are centred on (width - 1) / 2.
  double centre_px() const { return width_px > 0 ? (width_px - 1) / 2.0 : 0.0; }
};

// Linear weights from samples to mean, cosine and sine of the first harmonic, by least squares over
// as many harmonics as the shifts support: signal = mean + cosine cos(a) + sine sin(a) + ..., with
// a = 2 pi shift / period. Unused shifts have weight 0.
struct Demodulation {
  std::vector<float> mean, cosine, sine;  // [shift]
  double aliasing_px =
      0;  // rms error of the coordinate from harmonics the shifts cannot tell apart
};

// `use[i]` is nonzero where the sample at shift i exists; `least_blur_px` limits the upper
// harmonics. Nullopt if the shifts used do not determine a phase.
std::optional<Demodulation> make_demodulation(const PhaseFamily& family, std::span<const char> use,
                                              double least_blur_px);

}  // namespace estimation
