#include "estimation/models/gaussians.h"

#include <cmath>

#include "estimation/base/check.h"
#include "estimation/models/burley.h"

namespace estimation {

const std::array<Gaussian, 6>& profile_gaussians() {
  static constexpr std::array<Gaussian, 6> kGaussians{{{0.001645440551, 0.02816592251},
                                                       {0.01057256216, 0.03400463634},
                                                       {0.06793260966, 0.0959357638},
                                                       {0.4364920617, 0.2177604936},
                                                       {2.804622418, 0.3445633643},
                                                       {18.02073301, 0.2795698195}}};
  return kGaussians;
}

void Gaussians::transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                          std::span<double> out) const {
  check(k_times_l_d.size() == out.size(), "one value of R~ for each frequency");
  const double per_scale = 1 / burley_scale(diffuse_reflectance);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double k = k_times_l_d[i] * per_scale;
    double sum = 0;
    for (const Gaussian& gaussian : profile_gaussians())
      sum += gaussian.weight * std::exp(-0.5 * gaussian.variance * k * k);
    out[i] = diffuse_reflectance * sum;
  }
}

}  // namespace estimation
