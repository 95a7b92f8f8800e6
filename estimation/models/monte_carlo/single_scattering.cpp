#include "estimation/models/monte_carlo/single_scattering.h"

#include <numbers>

namespace estimation {

Quadrature gauss_legendre(int count) {
  Quadrature rule;
  for (int i = 0; i < count; ++i) {
    double t = std::cos(std::numbers::pi * (i + 0.75) / (count + 0.5));
    double slope = 1;
    for (int step = 0; step < 20; ++step) {
      double before = 1, value = t;
      for (int n = 2; n <= count; ++n) {
        const double next = ((2 * n - 1) * t * value - (n - 1) * before) / n;
        before = value;
        value = next;
      }
      slope = count * (t * value - before) / (t * t - 1);
      t -= value / slope;
    }
    rule.node.push_back(0.5 * (1 - t));
    rule.weight.push_back(1 / ((1 - t * t) * slope * slope));
  }
  return rule;
}

SingleScattering::SingleScattering(const WalkMedium& medium)
    : medium_(medium), sigma_s_(1 / (1 - medium.anisotropy)) {}

double SingleScattering::sum(double absorption, double k_tmfp, double cos_from,
                             double cos_to) const {
  static const Quadrature kRule = gauss_legendre(200);
  const double g = medium_.anisotropy, eta = medium_.eta;
  const double sigma_t = sigma_s_ + absorption;
  // c = 1 - v^2 takes out the square root at normal exit that large k brings.
  const double v_from = std::sqrt(1 - cos_to), v_range = std::sqrt(1 - cos_from) - v_from;
  double total = 0;
  for (std::size_t i = 0; i < kRule.node.size(); ++i) {
    const double v = v_from + v_range * kRule.node[i];
    const double c = 1 - v * v;
    const double m = std::sqrt(1 - (1 - c * c) / (eta * eta));
    const double phase =
        (1 - g * g) / (4 * std::numbers::pi * std::pow(1 + g * g + 2 * g * m, 1.5));
    const double through = 1 - inner_reflection(eta, m).reflected_frac;
    const double depth = std::hypot(sigma_t * (1 + m), k_tmfp * std::sqrt(1 - m * m));
    total += kRule.weight[i] * v_range * 2 * v * c * phase * through / depth;
  }
  return 2 * std::numbers::pi * sigma_s_ / (eta * eta) * total;
}

}  // namespace estimation
