#include "estimation/profile/tilt_noise.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/profile/small_matrix.h"

namespace estimation {
namespace {

constexpr double kStep = 0.1;   // of the logit; linear between: responses move by percents
constexpr double kSpan = 0.02;  // of the differences, in the logit and ln l_d
constexpr std::size_t kHarmonics = 20;

double reflectance_of(double logit) { return 1 / (1 + std::exp(-logit)); }
double square(double x) { return x * x; }

// What a sweep sees over one period, a sample for every projector pixel, over the light; B aside.
std::vector<double> sweep_of(const ScatteringModel& model, const TypicalSite& site, double logit,
                             double translucency_px) {
  const double period_px = site.shape.period_px;
  std::array<double, kHarmonics + 1> k_times_l_d{}, transform{};
  for (std::size_t n = 0; n <= kHarmonics; ++n)
    k_times_l_d[n] = 2 * std::numbers::pi * static_cast<double>(n) / period_px * translucency_px;
  model.transform(reflectance_of(logit), k_times_l_d, transform);
  const double duty = site.shape.width_px / period_px;
  std::vector<double> samples;
  for (int shift_px = 0; shift_px < site.shape.period_px; ++shift_px) {
    double value = duty * transform[0];
    for (std::size_t n = 1; n <= kHarmonics; ++n) {
      const double wave = std::numbers::pi * static_cast<double>(n);
      value += 2 * std::sin(wave * duty) / wave * transform[n] *
               std::cos(2 * wave * shift_px / period_px);
    }
    samples.push_back(value);
  }
  return samples;
}

// A solution of A x = b, zero where A has none: without contrast nothing can move.
template <std::size_t N>
std::array<double, N> solved(const SmallMatrix<N>& matrix, const std::array<double, N>& right) {
  const auto root = scaled_cholesky(matrix);
  return root ? root->solve(right) : std::array<double, N>{};
}

}  // namespace

// The weighted least-squares fit moves by (dt, dl, dB) where the samples r_j that it looks for are
// the true ones less their share e of the light: r_t dt + r_l dl + duty dB = -e (r + duty B).
TiltEffect::TiltEffect(const ScatteringModel& model, const TypicalSite& site, double least_logit,
                       double greatest_logit)
    : least_(least_logit) {
  const int count = 2 + static_cast<int>((greatest_logit - least_logit) / kStep);
  const double duty = static_cast<double>(site.shape.width_px) / site.shape.period_px;
  for (int i = 0; i < count; ++i) {
    const auto around = [&](double by_logit, double by_log) {
      return sweep_of(model, site, least_ + i * kStep + by_logit,
                      site.translucency_px * std::exp(by_log));
    };
    const std::vector<double> r = around(0, 0), t_up = around(kSpan, 0), t_down = around(-kSpan, 0),
                              l_up = around(0, kSpan), l_down = around(0, -kSpan);
    SmallMatrix<3> matrix{};
    std::array<double, 3> right{};
    for (std::size_t j = 0; j < r.size(); ++j) {
      const std::array<double, 3> by{(t_up[j] - t_down[j]) / (2 * kSpan),
                                     (l_up[j] - l_down[j]) / (2 * kSpan), duty};
      const double value = r[j] + duty * site.indirect;
      const double weight = 1 / variance_at(site.noise, site.full_per_us * std::max(value, 0.0));
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) matrix[a][b] += weight * by[a] * by[b];
        right[a] -= weight * by[a] * value;
      }
    }
    const std::array<double, 3> free = solved(matrix, right);
    const std::array<double, 2> fixed = solved<2>(
        {{{matrix[0][0], matrix[0][1]}, {matrix[1][0], matrix[1][1]}}}, {right[0], right[1]});
    responses_[0].push_back({.logit = fixed[0], .log_translucency = fixed[1]});
    responses_[1].push_back({.logit = free[0], .log_translucency = free[1], .indirect = free[2]});
  }
}

TiltEffect::Response TiltEffect::response_at(const TiltedFit& fit) const {
  const std::vector<Response>& nodes = responses_[fit.is_indirect_free];
  const double place = (fit.logit - least_) / kStep;
  const double cell = std::clamp(std::floor(place), 0.0, static_cast<double>(nodes.size()) - 2);
  const Response &a = nodes[static_cast<std::size_t>(cell)],
                 &b = nodes[static_cast<std::size_t>(cell) + 1];
  const double rest = place - cell;
  return {
      .logit = a.logit + rest * (b.logit - a.logit),
      .log_translucency = a.log_translucency + rest * (b.log_translucency - a.log_translucency)};
}

TiltVariances TiltEffect::at(const TiltedFit& fit, const CoefficientCurve::At& curves,
                             TiltNoise tilt) const {
  const Response by_light = response_at(fit);
  const double log_reflectance = (1 - reflectance_of(fit.logit)) * by_light.logit;
  // Tilts along the axis move the pitch by -e, and all lengths with it.
  const auto variance = [&](double by_light_e, double by_log_pitch) {
    return square((by_light_e - by_log_pitch) * tilt.along) + square(by_light_e * tilt.across);
  };
  const double log_translucency = by_light.log_translucency;
  return {
      .diffuse_reflectance = variance(log_reflectance, 0),
      .translucency = variance(log_translucency, 1),
      .sigma_a = variance(curves.sigma_a.slope * by_light.logit - log_translucency, -1),
      .sigma_s_prime = variance(curves.sigma_s_prime.slope * by_light.logit - log_translucency, -1),
      .indirect = variance(by_light.indirect, 0)};
}

}  // namespace estimation
