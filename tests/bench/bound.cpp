#include "tests/bench/bound.h"

#include <array>
#include <cmath>
#include <opencv2/core.hpp>

namespace bench {
namespace {

using estimation::Coefficients;
using estimation::truth::DipoleLineSpread;
using estimation::truth::PeriodicCurve;

constexpr double kLogStep = 1e-3;  // central differences: 1e-7 of truncation, 1e-9 of rounding
constexpr double kPhaseStepPx = 1e-3;
constexpr int kPhases = 32;  // of a pixel's position within one step of the shifts

using Vector = cv::Vec4d;  // ln sigma_a, ln sigma_s', B, u
using Matrix = cv::Matx44d;

Coefficients scaled(const Coefficients& medium, double log_a, double log_s) {
  return {.sigma_a_per_mm = medium.sigma_a_per_mm * std::exp(log_a),
          .sigma_s_prime_per_mm = medium.sigma_s_prime_per_mm * std::exp(log_s)};
}

}  // namespace

const BoundOfTruth::Derivatives& BoundOfTruth::derivatives(const Coefficients& medium,
                                                           double pitch_mm) {
  for (const Derivatives& known : known_)
    if (known.medium.sigma_a_per_mm == medium.sigma_a_per_mm &&
        known.medium.sigma_s_prime_per_mm == medium.sigma_s_prime_per_mm &&
        known.pitch_mm == pitch_mm)
      return known;
  const auto response = [&](const DipoleLineSpread& spread, double x_px) {
    return dipole_response(spread, shape_, pitch_mm, x_px);
  };
  Derivatives made{
      .medium = medium, .pitch_mm = pitch_mm, .value = {}, .by_log_a = {}, .by_log_s = {}};
  const DipoleLineSpread centre(medium, eta_);
  made.value = std::make_unique<PeriodicCurve>(shape_.period_px,
                                               [&](double x_px) { return response(centre, x_px); });
  const auto along = [&](double log_a, double log_s, double& reflectance, double& translucency) {
    const DipoleLineSpread above(scaled(medium, log_a, log_s), eta_);
    const DipoleLineSpread below(scaled(medium, -log_a, -log_s), eta_);
    const double step = 2 * kLogStep;
    reflectance =
        std::log(above.shape().diffuse_reflectance / below.shape().diffuse_reflectance) / step;
    translucency = std::log(above.shape().translucency_mm / below.shape().translucency_mm) / step;
    return std::make_unique<PeriodicCurve>(shape_.period_px, [&](double x_px) {
      return (response(above, x_px) - response(below, x_px)) / step;
    });
  };
  made.by_log_a = along(kLogStep, 0, made.reflectance_by_a, made.translucency_by_a);
  made.by_log_s = along(0, kLogStep, made.reflectance_by_s, made.translucency_by_s);
  known_.push_back(std::move(made));
  return known_.back();
}

Bound BoundOfTruth::bound(const Case& wanted) {
  const Derivatives& by = derivatives(wanted.medium, wanted.pitch_mm);
  const double duty = static_cast<double>(shape_.width_px) / shape_.period_px;
  const double full_signal = wanted.sensor.full_signal_dn_per_us();
  const auto noise = wanted.sensor.noise();
  std::array<double, 6> variance{};
  for (int phase = 0; phase < kPhases; ++phase) {
    const double step_px =
        static_cast<double>(shape_.period_px) / static_cast<double>(wanted.shifts_px.size());
    const double u_px = step_px * (phase + 0.5) / kPhases;
    Matrix information = Matrix::zeros();
    for (const int shift : wanted.shifts_px) {
      const double x_px = u_px - shift - 0.5 * (shape_.width_px - 1);
      const double signal = full_signal * ((*by.value)(x_px) + duty * wanted.indirect);
      const double by_u = ((*by.value)(x_px + kPhaseStepPx) - (*by.value)(x_px - kPhaseStepPx)) /
                          (2 * kPhaseStepPx);
      const Vector slope = full_signal * Vector((*by.by_log_a)(x_px), (*by.by_log_s)(x_px),
                                                wanted.is_indirect_free ? duty : 0.0, by_u);
      information += 1 / variance_at(noise, signal) * slope * slope.t();
    }
    if (!wanted.is_indirect_free) information(2, 2) = 1;  // fixed: no variance from it below
    const Matrix covariance = information.inv(cv::DECOMP_CHOLESKY);
    const auto along = [&](double a, double s) {
      return a * a * covariance(0, 0) + 2 * a * s * covariance(0, 1) + s * s * covariance(1, 1);
    };
    const std::array<double, 6> found{along(by.reflectance_by_a, by.reflectance_by_s),
                                      along(by.translucency_by_a, by.translucency_by_s),
                                      covariance(0, 0),
                                      covariance(1, 1),
                                      wanted.is_indirect_free ? covariance(2, 2) : 0,
                                      covariance(3, 3)};
    for (std::size_t i = 0; i < found.size(); ++i) variance[i] += found[i] / kPhases;
  }
  return {.log_reflectance = std::sqrt(variance[0]),
          .log_translucency = std::sqrt(variance[1]),
          .log_sigma_a = std::sqrt(variance[2]),
          .log_sigma_s_prime = std::sqrt(variance[3]),
          .indirect = std::sqrt(variance[4]),
          .phase_px = std::sqrt(variance[5])};
}

}  // namespace bench
