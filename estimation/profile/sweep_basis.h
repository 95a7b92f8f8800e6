// The shifts of a sweep as waves shared by all its pixels: what turns harmonics into samples.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "estimation/profile/likelihood.h"

namespace estimation {

// Enough for a period of 128 projector px in single steps; larger problems are for fit_pixel.
inline constexpr std::size_t kMostBatchSamples = 128;
inline constexpr std::size_t kMostBatchHarmonics = 64;

// A long sweep's first step takes so many harmonics of the data, as so many samples.
inline constexpr std::size_t kFirstHarmonics = 12, kFirstSamples = 28, kFewestOfFirst = 32;

// Sample j is r_j = mean + sum_n Re[G_n exp(-i n angle_j)], angle_j = 2 pi (shift_j - origin) / P.
struct SweepBasis {
  // Evenly spaced over the whole period, their number a multiple of four: sample j, S - j, S/2 - j
  // and S/2 + j share their waves, and harmonics n and S - n their bin.
  bool is_quartered = false;
  std::size_t sample_count = 0;
  float origin_px = 0;
  std::array<int, kMostBatchSamples> row_of{};  // [j] row of the batch's samples
  // [j][bin][cos, sin] of bin * angle_j, bins from 0, `bin_stride` of them; quartered: j = 0..S/4
  std::size_t bin_stride = 0;
  std::array<float, 2 * kMostBatchSamples*(kMostBatchHarmonics + 1)> waves{};
  std::array<int, kMostBatchHarmonics + 1> bin_of{};        // [n] where harmonic n appears
  std::array<bool, kMostBatchHarmonics + 1> is_mirrored{};  // [n] as its complex conjugate

  // Least squares without weights for the mean and two harmonics, G_1 and G_second.
  bool can_start = false;
  int second = 2;  // 3 where stripes have no second harmonic
  std::array<std::array<float, kMostBatchSamples>, 5> start{};  // mean, re, im, re, im; by j
  float start_variance = 0;  // of re G_1 for samples of unit variance
};

enum class Symmetry { kUsed, kIgnored };

// Quartered where the shifts allow it, unless they have offsets or symmetry is to be ignored. No
// allocation.
//   offset_px  [shift] or empty
//   harmonic_count  at most kMostBatchHarmonics; of shifts at most kMostBatchSamples
void make_sweep_basis(const FitProblem& problem, std::span<const float> offset_px,
                      int harmonic_count, Symmetry symmetry, SweepBasis& basis);

// An even sweep of so many samples, a multiple of four, that begins where a quartered one does: its
// waves and bins, without rows or a start.
void make_even_basis(std::size_t sample_count, int harmonic_count, SweepBasis& basis);

}  // namespace estimation
