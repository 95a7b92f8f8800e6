// Where a pixel's fit starts: the shape whose first two harmonics, or whose first harmonic and
// mean, are those of its samples. Read off a grid that inverts the table of harmonics once.
#pragma once

#include <cstddef>
#include <vector>

#include "estimation/profile/harmonic_table.h"
#include "estimation/profile/likelihood.h"

namespace estimation {

// Coordinates in which the inverse is smooth, x and y:
//   x = ln a_1
//   y = kFree: ln(-ln(a_m / (a_1 kRatioMargin r))), about ln l_d, r = sinc(m d) / sinc(d) the ratio
//       of a sharp stripe, m the second harmonic used; kZero: t itself
struct StartGrid {
  static constexpr int kSide = 64;
  static constexpr double kRatioMargin = 1.02;
  static constexpr double kLeastDecay = 5e-3;  // of -ln(...)

  StartGrid(const HarmonicTable& table, IndirectLight indirect, int second);

  float first_x = 0, first_y = 0, per_x = 0, per_y = 0;  // index = (x - first_x) * per_x
  float sharp_ratio = 1;                                 // kRatioMargin * r, with its sign
  std::vector<float> logit, log;                         // [x][y], kSide each
};

}  // namespace estimation
