#include "estimation/geometry/phase.h"

#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/core.hpp>

namespace estimation {
namespace {

constexpr double kTwoPi = 2 * std::numbers::pi;
constexpr int kMaxHarmonics = 12;
// Smallest singular value over the largest: 8 of 40 neighbouring shifts pass with one harmonic,
// three adjacent ones of 40 do not.
constexpr double kMinCondition = 0.02;
// Noise against which aliasing is weighed when the number of harmonics is chosen, in amplitudes.
constexpr double kTypicalNoise = 0.01;

std::vector<int> used_indices(std::span<const char> use) {
  std::vector<int> indices;
  for (std::size_t i = 0; i < use.size(); ++i) {
    if (use[i]) indices.push_back(static_cast<int>(i));
  }
  return indices;
}

// Columns 1, cos a, sin a, cos 2a, sin 2a, ...
cv::Mat1d design_matrix(const PhaseFamily& family, const std::vector<int>& indices,
                        int harmonic_count) {
  cv::Mat1d design(static_cast<int>(indices.size()), 1 + 2 * harmonic_count);
  for (int row = 0; row < design.rows; ++row) {
    const double shift_px = family.shift_px[static_cast<std::size_t>(indices[std::size_t(row)])];
    design(row, 0) = 1;
    for (int n = 1; n <= harmonic_count; ++n) {
      const double angle_rad = kTwoPi * n * shift_px / family.period_px;
      design(row, 2 * n - 1) = std::cos(angle_rad);
      design(row, 2 * n) = std::sin(angle_rad);
    }
  }
  return design;
}

// Amplitudes of the harmonics 1, 2, ... of a blurred pattern; those below 1e-6 are left out.
std::vector<double> harmonic_amplitudes(const PhaseFamily& family, double blur_px) {
  if (family.width_px == 0) return {1.0};
  std::vector<double> amplitudes;
  for (int n = 1; n < 4 * family.period_px; ++n) {
    const double angle_rad = std::numbers::pi * n * family.width_px / family.period_px;
    const double freq_rad_per_px = kTwoPi * n / family.period_px;
    const double transfer = std::exp(-0.5 * std::pow(freq_rad_per_px * blur_px, 2));
    if (n > 1 && transfer < 1e-6) break;
    amplitudes.push_back(std::sin(angle_rad) / angle_rad * transfer);
  }
  return amplitudes;
}

// std::complex multiplies by a function that looks for infinities; a pixel that lost samples has
// millions of these to do.
struct Phasor {
  double real = 0, imaginary = 0;

  void add(const Phasor& more, double factor) {
    real += factor * more.real;
    imaginary += factor * more.imaginary;
  }
};

Phasor operator*(const Phasor& a, const Phasor& b) {
  return {a.real * b.real - a.imaginary * b.imaginary, a.real * b.imaginary + a.imaginary * b.real};
}

Phasor conjugate(const Phasor& a) { return {a.real, -a.imaginary}; }

Phasor unit_phasor(double angle_rad) { return {std::cos(angle_rad), std::sin(angle_rad)}; }

double aliasing_rms_px(const PhaseFamily& family, const std::vector<int>& indices,
                       const Demodulation& weights, double blur_px) {
  const std::vector<double> amplitudes = harmonic_amplitudes(family, blur_px);
  // What the weights make of exp(i n a) and exp(-i n a), a the coordinate's angle.
  std::vector<Phasor> forward(amplitudes.size()), backward(amplitudes.size());
  for (const int index : indices) {
    const auto k = static_cast<std::size_t>(index);
    const Phasor weight{double{weights.cosine[k]}, double{weights.sine[k]}};
    const Phasor turn = unit_phasor(kTwoPi * family.shift_px[k] / family.period_px);
    Phasor power = turn;
    for (std::size_t n = 0; n < amplitudes.size(); ++n, power = power * turn) {
      forward[n].add(weight * conjugate(power), amplitudes[n] / 2);
      backward[n].add(weight * power, amplitudes[n] / 2);
    }
  }
  // A prime number of coordinates over one period: in step with no set of shifts.
  constexpr int kCoordinateCount = 101;
  double sum = 0;
  for (int i = 0; i < kCoordinateCount; ++i) {
    const Phasor turn = unit_phasor(kTwoPi * i / kCoordinateCount);
    Phasor power = turn, harmonic;
    for (std::size_t n = 0; n < amplitudes.size(); ++n, power = power * turn) {
      harmonic.add(forward[n] * power, 1);
      harmonic.add(backward[n] * conjugate(power), 1);
    }
    const Phasor left = harmonic * conjugate(turn);
    const double error_rad = std::atan2(left.imaginary, left.real);
    sum += error_rad * error_rad;
  }
  return std::sqrt(sum / kCoordinateCount) * family.period_px / kTwoPi;
}

double noise_px(const PhaseFamily& family, const Demodulation& weights) {
  double sum = 0;
  for (std::size_t i = 0; i < weights.cosine.size(); ++i) {
    sum += std::pow(double{weights.cosine[i]}, 2) + std::pow(double{weights.sine[i]}, 2);
  }
  return kTypicalNoise * std::sqrt(sum / 2) * family.period_px / kTwoPi;
}

std::optional<Demodulation> with_harmonics(const PhaseFamily& family,
                                           const std::vector<int>& indices, int harmonic_count,
                                           double blur_px) {
  const cv::Mat1d design = design_matrix(family, indices, harmonic_count);
  cv::Mat1d inverse;
  if (cv::invert(design, inverse, cv::DECOMP_SVD) < kMinCondition) return std::nullopt;
  const std::size_t shift_count = family.shift_px.size();
  Demodulation weights{std::vector<float>(shift_count), std::vector<float>(shift_count),
                       std::vector<float>(shift_count)};
  for (int i = 0; i < static_cast<int>(indices.size()); ++i) {
    const auto k = static_cast<std::size_t>(indices[static_cast<std::size_t>(i)]);
    weights.mean[k] = static_cast<float>(inverse(0, i));
    weights.cosine[k] = static_cast<float>(inverse(1, i));
    weights.sine[k] = static_cast<float>(inverse(2, i));
  }
  weights.aliasing_px = aliasing_rms_px(family, indices, weights, blur_px);
  return weights;
}

}  // namespace

std::optional<Demodulation> make_demodulation(const PhaseFamily& family, std::span<const char> use,
                                              double least_blur_px) {
  const std::vector<int> indices = used_indices(use);
  std::optional<Demodulation> best;
  double best_error_px = std::numeric_limits<double>::infinity();
  const int most = family.width_px == 0 ? 1 : kMaxHarmonics;
  for (int count = 1; count <= most && 2 * count + 1 <= static_cast<int>(indices.size()); ++count) {
    auto weights = with_harmonics(family, indices, count, least_blur_px);
    if (!weights) continue;
    const double error_px = std::hypot(weights->aliasing_px, noise_px(family, *weights));
    if (error_px >= best_error_px * 0.999) continue;  // equally good: fewer harmonics
    best_error_px = error_px;
    best = std::move(weights);
  }
  return best;
}

}  // namespace estimation
