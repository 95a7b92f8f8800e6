// A number that was measured, with its uncertainty.
#pragma once

namespace estimation {

struct Measured {
  double value = 0;
  double sd = 0;  // standard deviation, in the value's unit
};

}  // namespace estimation
