#include "tests/estimation/truth/line_spread.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace estimation::truth {
namespace {

using std::numbers::pi;

constexpr double kStep = 0.1;      // of the trapezoid rule in t
constexpr double kReach = 42;      // diffuse mean free paths: exp(-42) = 6e-19
constexpr double kGreatestT = 20;  // exp(-2 t) = 4e-18 where absorption does not end it sooner

double internal_reflection_factor(double eta) {
  const double diffuse_fresnel = -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta;
  return (1 + diffuse_fresnel) / (1 - diffuse_fresnel);
}

}  // namespace

DipoleLineSpread::DipoleLineSpread(const Coefficients& medium, double eta) {
  const double extinction_per_mm = medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm;
  albedo_ = medium.sigma_s_prime_per_mm / extinction_per_mm;
  sigma_tr_per_mm_ = std::sqrt(3 * medium.sigma_a_per_mm * extinction_per_mm);
  source_depth_mm_[0] = 1 / extinction_per_mm;
  source_depth_mm_[1] = source_depth_mm_[0] * (1 + 4 * internal_reflection_factor(eta) / 3);

  const double reach_mm = kReach / sigma_tr_per_mm_;
  for (double start_mm = 0; start_mm < reach_mm;) {
    const double to_pole_mm = std::hypot(start_mm, source_depth_mm_[0]);
    const double width_mm = std::min(0.5 * to_pole_mm, 1.5 / sigma_tr_per_mm_);
    panels_.push_back(make_panel(start_mm, start_mm + width_mm));
    start_mm += width_mm;
  }
  double beyond_start = 0;
  for (auto panel = panels_.rbegin(); panel != panels_.rend(); ++panel) {
    beyond_start += integral_from_start(*panel, panel->end_mm);
    panel->beyond_start = beyond_start;
  }
}

// Eq. 3 along the line: with y = rho sinh t and d = rho cosh t, dy = d dt.
double DipoleLineSpread::line_spread_per_mm(double x_mm) const {
  double sum = 0;
  for (const double z_mm : source_depth_mm_) {
    const double rho_mm = std::hypot(x_mm, z_mm);
    const auto integrand = [&](double t) {
      const double d_mm = rho_mm * std::cosh(t);
      return z_mm * (sigma_tr_per_mm_ + 1 / d_mm) * std::exp(-sigma_tr_per_mm_ * d_mm) / d_mm;
    };
    double line = integrand(0);
    for (double t = kStep; t < kGreatestT; t += kStep) {
      const double term = 2 * integrand(t);
      line += term;
      if (term < 1e-20 * line) break;
    }
    sum += kStep * line;
  }
  return albedo_ / (4 * pi) * sum;
}

// L at the Chebyshev nodes of the panel, its series, and the series' integral.
DipoleLineSpread::Panel DipoleLineSpread::make_panel(double start_mm, double end_mm) const {
  constexpr int kNodes = kDegree + 1;
  const double half_mm = 0.5 * (end_mm - start_mm);
  double values[kNodes], coefficients[kNodes + 2] = {};
  for (int node = 0; node < kNodes; ++node)
    values[node] =
        line_spread_per_mm(start_mm + half_mm * (1 + std::cos(pi * (node + 0.5) / kNodes)));
  for (int order = 0; order < kNodes; ++order) {
    double sum = 0;
    for (int node = 0; node < kNodes; ++node)
      sum += values[node] * std::cos(pi * order * (node + 0.5) / kNodes);
    coefficients[order] = (order == 0 ? 1.0 : 2.0) / kNodes * sum;
  }
  Panel panel{.start_mm = start_mm, .end_mm = end_mm};
  coefficients[0] *= 2;  // the recurrence below takes c_0 twice
  double at_start = 0;
  for (int order = 1; order <= kNodes; ++order) {
    panel.series[order] =
        half_mm * (coefficients[order - 1] - coefficients[order + 1]) / (2 * order);
    at_start += (order % 2 == 0 ? 1 : -1) * panel.series[order];
  }
  panel.series[0] = -at_start;
  return panel;
}

double DipoleLineSpread::integral_from_start(const Panel& panel, double x_mm) const {
  const double position =
      (2 * x_mm - panel.start_mm - panel.end_mm) / (panel.end_mm - panel.start_mm);
  double next = 0, after_next = 0;  // Clenshaw
  for (int order = kDegree + 1; order >= 1; --order) {
    const double current = panel.series[order] + 2 * position * next - after_next;
    after_next = next;
    next = current;
  }
  return panel.series[0] + position * next - after_next;
}

double DipoleLineSpread::beyond(double x_mm) const {
  if (x_mm < 0) return diffuse_reflectance() - beyond(-x_mm);
  if (x_mm >= reach_mm()) return 0;
  const auto panel =
      std::upper_bound(panels_.begin(), panels_.end(), x_mm,
                       [](double x, const Panel& candidate) { return x < candidate.end_mm; });
  return panel->beyond_start - integral_from_start(*panel, x_mm);
}

}  // namespace estimation::truth
