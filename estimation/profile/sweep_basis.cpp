#include "estimation/profile/sweep_basis.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/base/check.h"
#include "estimation/profile/small_matrix.h"

namespace estimation {
namespace {

double envelope(StripeShape shape, int n) {
  return std::abs(std::sin(std::numbers::pi * n * shape.width_px / shape.period_px)) / n;
}

// Sorts the shifts; true if they divide the period evenly into a multiple of four.
bool sort_into_quarters(const FitProblem& problem, SweepBasis& basis) {
  const auto count = basis.sample_count;
  const int period = problem.shape.period_px;
  const auto shift = [&](std::size_t j) {
    return problem.shifts_px[static_cast<std::size_t>(basis.row_of[j])];
  };
  std::sort(basis.row_of.begin(), basis.row_of.begin() + static_cast<std::ptrdiff_t>(count),
            [&](int a, int b) {
              return problem.shifts_px[static_cast<std::size_t>(a)] <
                     problem.shifts_px[static_cast<std::size_t>(b)];
            });
  if (count % 4 != 0 || period % static_cast<int>(count) != 0) return false;
  const int step = period / static_cast<int>(count);
  for (std::size_t j = 1; j < count; ++j)
    if (shift(j) - shift(j - 1) != step) return false;
  return true;
}

void fill_waves(double angle, std::size_t j, SweepBasis& basis) {
  const double re = std::cos(angle), im = std::sin(angle);
  double turn_re = 1, turn_im = 0;
  float* wave = basis.waves.data() + 2 * j * basis.bin_stride;
  for (std::size_t bin = 0; bin < basis.bin_stride; ++bin) {
    *wave++ = static_cast<float>(turn_re);
    *wave++ = static_cast<float>(turn_im);
    const double next_re = turn_re * re - turn_im * im;
    turn_im = turn_re * im + turn_im * re;
    turn_re = next_re;
  }
}

// Waves of all bins, and where harmonics appear.
void fill_bins(std::span<const double> angles, int harmonic_count, SweepBasis& basis) {
  const std::size_t count = angles.size();
  const int samples = static_cast<int>(count);
  const bool has_first = basis.is_quartered && count >= kFewestOfFirst;
  const int least = has_first ? static_cast<int>(kFirstHarmonics) : 0;
  const int bins =
      basis.is_quartered ? std::min(std::max(harmonic_count, least), samples / 2) : harmonic_count;
  basis.bin_stride = static_cast<std::size_t>(bins) + 1;
  for (std::size_t j = 0; j < (basis.is_quartered ? count / 4 + 1 : count); ++j)
    fill_waves(angles[j], j, basis);
  for (int n = 0; n <= harmonic_count; ++n) {
    const auto index = static_cast<std::size_t>(n);
    const int turn = basis.is_quartered ? n % samples : n;
    basis.is_mirrored[index] = basis.is_quartered && 2 * turn > samples;
    basis.bin_of[index] = basis.is_mirrored[index] ? samples - turn : turn;
  }
}

void fill_start(std::span<const double> angles, SweepBasis& basis) {
  SmallMatrix<5> normal{};
  const auto row_at = [&](double angle) {
    return std::array<double, 5>{1, std::cos(angle), std::sin(angle),
                                 std::cos(basis.second * angle), std::sin(basis.second * angle)};
  };
  for (const double angle : angles) {
    const auto row = row_at(angle);
    for (std::size_t i = 0; i < 5; ++i)
      for (std::size_t k = 0; k < 5; ++k) normal[i][k] += row[i] * row[k];
  }
  const auto inverse = inverse_of(normal);
  basis.can_start = inverse.has_value();
  if (!inverse) return;
  basis.start_variance = static_cast<float>(0.5 * ((*inverse)[1][1] + (*inverse)[2][2]));
  for (std::size_t j = 0; j < angles.size(); ++j) {
    const auto row = row_at(angles[j]);
    for (std::size_t i = 0; i < 5; ++i) {
      double sum = 0;
      for (std::size_t k = 0; k < 5; ++k) sum += (*inverse)[i][k] * row[k];
      basis.start[i][j] = static_cast<float>(sum);
    }
  }
}

}  // namespace

void make_sweep_basis(const FitProblem& problem, std::span<const float> offset_px,
                      int harmonic_count, Symmetry symmetry, SweepBasis& basis) {
  const std::size_t count = problem.shifts_px.size();
  check(count <= kMostBatchSamples && harmonic_count > 0 &&
            harmonic_count <= static_cast<int>(kMostBatchHarmonics),
        "a sweep basis of bounded size");
  basis.sample_count = count;
  for (std::size_t j = 0; j < count; ++j) basis.row_of[j] = static_cast<int>(j);
  basis.is_quartered =
      symmetry == Symmetry::kUsed && offset_px.empty() && sort_into_quarters(problem, basis);
  basis.second = envelope(problem.shape, 2) > envelope(problem.shape, 3) ? 2 : 3;
  const double wave_per_px = 2 * std::numbers::pi / problem.shape.period_px;
  const auto row = [&](std::size_t j) { return static_cast<std::size_t>(basis.row_of[j]); };
  const double origin_px = basis.is_quartered ? problem.shifts_px[row(0)] : 0;
  basis.origin_px = static_cast<float>(origin_px);
  std::array<double, kMostBatchSamples> angles{};
  for (std::size_t j = 0; j < count; ++j) {
    const double offset = offset_px.empty() ? 0 : static_cast<double>(offset_px[row(j)]);
    angles[j] = wave_per_px * (problem.shifts_px[row(j)] + offset - origin_px);
  }
  fill_start(std::span(angles).first(count), basis);
  fill_bins(std::span(angles).first(count), harmonic_count, basis);
}

void make_even_basis(std::size_t sample_count, int harmonic_count, SweepBasis& basis) {
  check(sample_count % 4 == 0 && sample_count <= kMostBatchSamples, "a quartered sweep");
  basis.is_quartered = true;
  basis.sample_count = sample_count;
  std::array<double, kMostBatchSamples> angles{};
  for (std::size_t j = 0; j < sample_count; ++j)
    angles[j] = 2 * std::numbers::pi * static_cast<double>(j) / static_cast<double>(sample_count);
  fill_bins(std::span(angles).first(sample_count), harmonic_count, basis);
}

}  // namespace estimation
