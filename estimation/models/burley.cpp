#include "estimation/models/burley.h"

#include <cmath>

#include "estimation/base/check.h"

namespace estimation {

double burley_scale(double diffuse_reflectance) {
  const double from_third = diffuse_reflectance - 0.33;
  return 3.5 + 100 * from_third * from_third * from_third * from_third;
}

void Burley::transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                       std::span<double> out) const {
  check(k_times_l_d.size() == out.size(), "one value of R~ for each frequency");
  const double per_scale = 1 / burley_scale(diffuse_reflectance);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double k_times_d = k_times_l_d[i] * per_scale, square = k_times_d * k_times_d;
    out[i] =
        0.25 * diffuse_reflectance * (1 / std::sqrt(1 + square) + 3 / std::sqrt(1 + 9 * square));
  }
}

}  // namespace estimation
