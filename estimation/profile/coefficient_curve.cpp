#include "estimation/profile/coefficient_curve.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace estimation {
namespace {

// The cubic between four nodes errs by 2e-9 over this step for the dipole.
constexpr double kStep = 0.02;

CoefficientCurve::Value cubic(const std::vector<double>& nodes, std::size_t first, double x) {
  const double a = nodes[first], b = nodes[first + 1], c = nodes[first + 2], d = nodes[first + 3];
  // Lagrange's polynomial through -1, 0, 1, 2 in powers of x.
  const double x3 = (d - a) / 6 + (b - c) / 2, x2 = (a + c) / 2 - b;
  const double x1 = c - b - x2 - x3;
  return {.log_product = b + x * (x1 + x * (x2 + x * x3)),
          .slope = (x1 + x * (2 * x2 + 3 * x * x3)) / kStep};
}

// A float of one is R_d below it by at most this much.
constexpr double kLeastOfOne = 3e-8;

double logit_of(double reflectance) {
  return std::log(std::max(reflectance, 1e-30) / std::max(1 - reflectance, kLeastOfOne));
}

}  // namespace

CoefficientCurve::CoefficientCurve(const ScatteringModel& model, double least_logit,
                                   double greatest_logit)
    : least_(least_logit), step_(kStep) {
  const int count = 4 + static_cast<int>((greatest_logit - least_logit) / step_);
  for (int i = 0; i < count; ++i) {
    const double logit = least_ + (i - 1) * step_;
    const Coefficients medium = model.coefficients(1 / (1 + std::exp(-logit)), 1);
    log_a_.push_back(std::log(medium.sigma_a_per_mm));
    log_s_.push_back(std::log(medium.sigma_s_prime_per_mm));
  }
}

CoefficientCurve::At CoefficientCurve::at(double logit) const {
  const double place = (logit - least_) / step_;
  const auto last = static_cast<double>(log_a_.size() - 4);
  const double cell = std::clamp(std::floor(place), 0.0, last);
  const auto first = static_cast<std::size_t>(cell);
  return {.sigma_a = cubic(log_a_, first, place - cell),
          .sigma_s_prime = cubic(log_s_, first, place - cell)};
}

Coefficients CoefficientCurve::coefficients(double diffuse_reflectance,
                                            double translucency_mm) const {
  const At curves = at(logit_of(diffuse_reflectance));
  return {.sigma_a_per_mm = std::exp(curves.sigma_a.log_product) / translucency_mm,
          .sigma_s_prime_per_mm = std::exp(curves.sigma_s_prime.log_product) / translucency_mm};
}

std::optional<CoefficientCurve> curve_over(const ScatteringModel& model,
                                           const Image<float>& diffuse_reflectance) {
  float least = std::numeric_limits<float>::infinity(), greatest = -least;
  for (const float value : diffuse_reflectance.samples())
    if (std::isfinite(value)) {
      least = std::min(least, value);
      greatest = std::max(greatest, value);
    }
  if (!(least <= greatest)) return std::nullopt;
  return CoefficientCurve(model, logit_of(static_cast<double>(least)),
                          logit_of(static_cast<double>(greatest)));
}

}  // namespace estimation
