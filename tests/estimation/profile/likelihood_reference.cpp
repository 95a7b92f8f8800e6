#include "likelihood_reference.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace estimation::testing {
namespace {

constexpr Real kPi = std::numbers::pi_v<Real>;

// The dipole of design/estimation.md, section 1, in s = sqrt(3 (1 - alpha')).
struct ReferenceDipole {
  Real virtual_source;  // z_v / z_r

  explicit ReferenceDipole(Real eta) {
    const Real reflected = -1.440L / (eta * eta) + 0.710L / eta + 0.668L + 0.0636L * eta;
    virtual_source = 1 + 4.0L / 3 * (1 + reflected) / (1 - reflected);
  }
  Real transform(Real s, Real k_times_l_d) const {
    const Real q = s * std::sqrt(1 + k_times_l_d * k_times_l_d);
    return (1 - s * s / 3) / 2 * (std::exp(-q) + std::exp(-virtual_source * q));
  }
  Real s_of(Real reflectance) const {
    Real low = 0, high = std::sqrt(3.0L);
    for (int halving = 0; halving < 80; ++halving) {
      const Real middle = (low + high) / 2;
      (transform(middle, 0) > reflectance ? low : high) = middle;
    }
    return (low + high) / 2;
  }
};

Real reflectance_of(Real logit) { return 1 / (1 + std::exp(-logit)); }

using Vector4 = std::array<Real, 4>;

Vector4 as_vector(const ReferencePoint& point) {
  return {point.logit, point.log_translucency_px, point.indirect, point.phase_px};
}
ReferencePoint as_point(const Vector4& v) { return {v[0], v[1], v[2], v[3]}; }

// Inverse by Gauss-Jordan with row exchanges; only the unknowns that are used.
std::vector<std::vector<Real>> inverse(std::vector<std::vector<Real>> matrix) {
  const std::size_t n = matrix.size();
  std::vector<std::vector<Real>> result(n, std::vector<Real>(n, 0));
  for (std::size_t i = 0; i < n; ++i) result[i][i] = 1;
  for (std::size_t col = 0; col < n; ++col) {
    std::size_t pivot = col;
    for (std::size_t row = col; row < n; ++row)
      if (std::abs(matrix[row][col]) > std::abs(matrix[pivot][col])) pivot = row;
    std::swap(matrix[col], matrix[pivot]);
    std::swap(result[col], result[pivot]);
    const Real scale = 1 / matrix[col][col];
    for (std::size_t i = 0; i < n; ++i) matrix[col][i] *= scale, result[col][i] *= scale;
    for (std::size_t row = 0; row < n; ++row) {
      if (row == col) continue;
      const Real share = matrix[row][col];
      for (std::size_t i = 0; i < n; ++i) {
        matrix[row][i] -= share * matrix[col][i];
        result[row][i] -= share * result[col][i];
      }
    }
  }
  return result;
}

}  // namespace

std::vector<Real> reference_signals(const ReferencePixel& pixel, const ReferencePoint& point) {
  const ReferenceDipole dipole(pixel.eta);
  const Real duty = static_cast<Real>(pixel.width_px) / pixel.period_px;
  const Real wave = 2 * kPi / pixel.period_px;
  const Real s = dipole.s_of(reflectance_of(point.logit));
  const Real l_d = std::exp(point.log_translucency_px);
  std::vector<std::complex<Real>> amplitudes;
  const std::size_t most = pixel.factors.empty() ? 4000 : pixel.factors.size() - 1;
  for (std::size_t n = 1; n <= most; ++n) {
    const Real order = static_cast<Real>(n);
    const Real transform = dipole.transform(s, order * wave * l_d);
    if (transform < 1e-12L) break;
    const std::complex<Real> factor = pixel.factors.empty() ? 1 : pixel.factors[n];
    amplitudes.push_back(factor * (2 * std::sin(kPi * order * duty) / (kPi * order) * transform));
  }
  const Real factor = pixel.factors.empty() ? 1 : pixel.factors[0].real();
  const Real mean =
      factor * (duty + pixel.black_frac) * (reflectance_of(point.logit) + point.indirect);
  std::vector<Real> signals;
  for (const Real shift : pixel.shifts_px) {
    const Real x =
        pixel.position_px + point.phase_px - shift - static_cast<Real>(pixel.width_px - 1) / 2;
    Real sum = mean;
    for (std::size_t n = 1; n <= amplitudes.size(); ++n) {
      const Real angle = static_cast<Real>(n) * wave * x;
      sum += (amplitudes[n - 1] * std::complex<Real>(std::cos(angle), std::sin(angle))).real();
    }
    signals.push_back(pixel.full_signal * sum);
  }
  return signals;
}

// As noise.h words it: from entry to entry linearly over six of the lower one's standard deviations
// at its end. Entries lie farther apart than that.
Real reference_variance(const ReferencePixel& pixel, Real signal) {
  const auto of = [](const MergedNoise& entry, Real at) {
    return static_cast<Real>(entry.read_variance) +
           static_cast<Real>(entry.shot_dn_per_us) * std::max<Real>(at, 0);
  };
  std::size_t entry = 0;
  for (; entry + 1 < pixel.noise.size(); ++entry) {
    const Real end = static_cast<Real>(pixel.noise[entry].up_to_dn_per_us);
    const Real half_width = 3 * std::sqrt(of(pixel.noise[entry], end));
    if (signal > end + half_width) continue;
    if (signal <= end - half_width) break;
    const Real share = (signal - end + half_width) / (2 * half_width);
    return (1 - share) * of(pixel.noise[entry], signal) +
           share * of(pixel.noise[entry + 1], signal);
  }
  return of(pixel.noise[entry], signal);
}

namespace {

// Box's bias from the signals' second derivatives by differences, then that of R_d, l_d and
// R_d + B, which bend over the unknowns; at most half a standard deviation.
ReferencePoint without_bias(const ReferencePixel& pixel, const std::vector<float>& samples,
                            const Vector4& at, const std::vector<std::size_t>& unknowns,
                            const std::vector<std::vector<Real>>& slopes,
                            const std::vector<std::vector<Real>>& covariance) {
  const std::size_t n = unknowns.size();
  const std::vector<Real> signals = reference_signals(pixel, as_point(at));
  std::vector<Real> gradient(n, 0), bias(n, 0);
  std::vector<Real> shift(signals.size(), 0);  // 1/2 tr(H C)
  constexpr Real h = 1e-3L;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t k = 0; k < n; ++k)
      for (const Real sign : {1.0L, -1.0L})
        for (const Real other : {1.0L, -1.0L}) {
          Vector4 moved = at;
          moved[unknowns[i]] += sign * h;
          moved[unknowns[k]] += other * h;
          const auto there = reference_signals(pixel, as_point(moved));
          for (std::size_t j = 0; j < shift.size(); ++j)
            shift[j] += sign * other * there[j] / (8 * h * h) * covariance[i][k];
        }
  for (std::size_t j = 0; j < shift.size(); ++j)
    for (std::size_t i = 0; i < n && !std::isnan(samples[j]); ++i)
      gradient[i] += slopes[i][j] * shift[j] / reference_variance(pixel, signals[j]);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t k = 0; k < n; ++k) bias[i] -= covariance[i][k] * gradient[k];
  const Real reflectance = reflectance_of(at[0]), slope = reflectance * (1 - reflectance);
  const Real bend = (1 - 2 * reflectance) * covariance[0][0] / 2;
  const bool is_free = n == 4;
  const Real mean = reflectance + at[2];
  // of t, ln l_d, R_d + B, phase
  Vector4 change = {-bias[0] - bend, -bias[1] - covariance[1][1] / 2, 0, -bias[n - 1]};
  if (is_free) change[2] = -bias[2] + slope * change[0];
  Vector4 in_unknowns = change;
  in_unknowns[2] = is_free ? -bias[2] : 0;
  const auto information = inverse(covariance);
  Real length = 0;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t k = 0; k < n; ++k)
      length += in_unknowns[unknowns[i]] * information[i][k] * in_unknowns[unknowns[k]];
  const Real share = std::min(1.0L, 0.5L / std::sqrt(length));
  ReferencePoint point{.logit = at[0] + share * change[0],
                       .log_translucency_px = at[1] + share * change[1],
                       .phase_px = at[3] + share * change[3]};
  if (is_free) point.indirect = mean + share * change[2] - reflectance_of(point.logit);
  return point;
}

}  // namespace

std::optional<ReferenceFit> reference_fit(const ReferencePixel& pixel,
                                          const std::vector<float>& samples,
                                          const ReferencePoint& start, bool is_indirect_free) {
  std::vector<std::size_t> unknowns = {0, 1, 3};
  if (is_indirect_free) unknowns = {0, 1, 2, 3};
  const std::size_t n = unknowns.size();
  Vector4 at = as_vector(start);
  for (int step = 0; step < 60; ++step) {
    const std::vector<Real> signals = reference_signals(pixel, as_point(at));
    std::vector<std::vector<Real>> slopes;
    for (const std::size_t unknown : unknowns) {
      constexpr Real h = 1e-5L;
      Vector4 above = at, below = at;
      above[unknown] += h;
      below[unknown] -= h;
      const auto up = reference_signals(pixel, as_point(above));
      const auto down = reference_signals(pixel, as_point(below));
      slopes.emplace_back();
      for (std::size_t j = 0; j < up.size(); ++j)
        slopes.back().push_back((up[j] - down[j]) / (2 * h));
    }
    std::vector<std::vector<Real>> normal(n, std::vector<Real>(n, 0));
    std::vector<Real> gradient(n, 0);
    Real chi_square = 0;
    for (std::size_t j = 0; j < samples.size(); ++j) {
      if (std::isnan(samples[j])) continue;
      const Real weight = 1 / reference_variance(pixel, signals[j]);
      const Real residual = static_cast<Real>(samples[j]) - signals[j];
      chi_square += weight * residual * residual;
      for (std::size_t i = 0; i < n; ++i) {
        gradient[i] += weight * slopes[i][j] * residual;
        for (std::size_t k = 0; k < n; ++k) normal[i][k] += weight * slopes[i][j] * slopes[k][j];
      }
    }
    const auto covariance = inverse(normal);
    Real largest = 0;  // of the step, in standard deviations
    for (std::size_t i = 0; i < n; ++i) {
      Real change = 0;
      for (std::size_t k = 0; k < n; ++k) change += covariance[i][k] * gradient[k];
      at[unknowns[i]] += change;
      largest = std::max(largest, std::abs(change) / std::sqrt(covariance[i][i]));
    }
    if (largest > 1e-8L) continue;
    ReferenceFit fit{.point = {}, .chi_square = chi_square};
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t row = unknowns[i];
      fit.sd[row] = std::sqrt(covariance[i][i]);
      for (std::size_t k = 0; k <= i; ++k)
        fit.covariance[row * (row + 1) / 2 + unknowns[k]] = covariance[i][k];
    }
    fit.point = without_bias(pixel, samples, at, unknowns, slopes, covariance);
    return fit;
  }
  return std::nullopt;
}

}  // namespace estimation::testing
