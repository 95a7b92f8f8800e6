#include "estimation/models/monte_carlo/uniform_spline.h"

#include "estimation/base/check.h"

namespace estimation {

// At every node (c[i - 1] + 4 c[i] + c[i + 1]) / 6 = value; the ends close the system.
std::vector<double> spline_coefficients(std::span<const double> values, SplineStart start) {
  check(values.size() >= 4, "a cubic spline has at least four nodes");
  const std::size_t count = values.size();
  // Natural ends: c[-1] - 2 c[0] + c[1] = 0, so c[0] = value. Even: c[-1] = c[1].
  std::vector<double> c(count + 2), upper(count);
  const bool even = start == SplineStart::kEven;
  upper[0] = even ? 0.5 : 0;
  c[1] = even ? 1.5 * values[0] : values[0];
  for (std::size_t i = 1; i + 1 < count; ++i) {
    const double pivot = 4 - upper[i - 1];
    upper[i] = 1 / pivot;
    c[i + 1] = (6 * values[i] - c[i]) / pivot;
  }
  c[count] = values[count - 1];
  for (std::size_t i = count - 1; i-- > 0;) c[i + 1] -= upper[i] * c[i + 2];
  c[0] = even ? c[2] : 2 * c[1] - c[2];
  c[count + 1] = 2 * c[count] - c[count - 1];
  return c;
}

}  // namespace estimation
