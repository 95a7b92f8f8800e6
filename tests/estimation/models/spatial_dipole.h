// The paper's eq. 3 in space, and its integrals by quadrature: what the closed forms are tested
// against.
#pragma once

#include <array>
#include <cmath>
#include <numbers>

#include "estimation/models/dipole.h"

namespace estimation::testing {

// Composite Gauss-Legendre with five nodes a panel.
template <class Function>
double integrate(const Function& f, double low, double high, int panels) {
  constexpr std::array<double, 5> kNodes = {0.0, 0.5384693101056831, -0.5384693101056831,
                                            0.9061798459386640, -0.9061798459386640};
  constexpr std::array<double, 5> kWeights = {0.5688888888888889, 0.4786286704993665,
                                              0.4786286704993665, 0.2369268850561891,
                                              0.2369268850561891};
  double sum = 0;
  const double half = (high - low) / panels / 2;
  for (int panel = 0; panel < panels; ++panel)
    for (std::size_t i = 0; i < kNodes.size(); ++i)
      sum += kWeights[i] * f(low + half * (2 * panel + 1 + kNodes[i]));
  return sum * half;
}

// Straight from the text; sigma_tr, z_r and z_v as in Jensen et al. (2001). Lengths in any unit.
struct SpatialDipole {
  double albedo, sigma_tr, z_real, z_virtual;

  SpatialDipole(const Coefficients& medium, double eta) {
    const double extinction = medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm;
    albedo = medium.sigma_s_prime_per_mm / extinction;
    sigma_tr = std::sqrt(3 * medium.sigma_a_per_mm * extinction);
    z_real = 1 / extinction;
    z_virtual = z_real * (1 + 4.0 / 3.0 * boundary_factor(eta));
  }
  static double source(double z, double sigma_tr, double r) {
    const double d = std::hypot(r, z);
    return z * (sigma_tr + 1 / d) * std::exp(-sigma_tr * d) / (d * d);
  }
  double at(double r) const {
    return albedo / (4 * std::numbers::pi) *
           (source(z_real, sigma_tr, r) + source(z_virtual, sigma_tr, r));
  }

  // Response to a line of light at distance x: eq. 3 integrated along the line, y = hypot(x, z)
  // sinh(t) for each source. The integrand is analytic and falls as exp(-exp(t)), so that the
  // trapezium rule converges beyond double precision.
  double line_response(double x) const {
    return albedo / (2 * std::numbers::pi) * (line_of(z_real, x) + line_of(z_virtual, x));
  }

 private:
  double line_of(double z, double x) const {
    constexpr double kStep = 0.125;
    const double scale = std::hypot(x, z);
    double sum = 0.5 * source(z, sigma_tr, std::abs(x)) * scale;
    for (int i = 1;; ++i) {
      const double grown = std::exp(kStep * i), shrunk = 1 / grown;
      const double y = scale * 0.5 * (grown - shrunk);
      const double term = source(z, sigma_tr, std::hypot(x, y)) * scale * 0.5 * (grown + shrunk);
      sum += term;
      if (!(term > 1e-17 * sum)) return sum * kStep;
    }
  }
};

}  // namespace estimation::testing
