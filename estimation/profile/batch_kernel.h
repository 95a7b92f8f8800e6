// The joint likelihood fit of vectors of pixels, in single precision (Highway).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "estimation/profile/likelihood.h"
#include "estimation/profile/start_grid.h"
#include "estimation/profile/sweep_basis.h"

namespace estimation {

// What the vector code leaves to fit_pixel carries this as its validity.
inline constexpr std::uint32_t kLeftToFitPixel = 0xFFFFFFFFU;

// A FitProblem in the form that the vectors take.
struct BatchPlan {
  static constexpr std::size_t kMostNoise = 8;
  struct Noise {
    float read_variance = 0, shot_dn_per_us = 0;
    // Share of the next entry at a signal: signal * per_width - middle, within 0 and 1.
    float per_width = 0, middle = 0;
  };

  const HarmonicTable* table = nullptr;
  const StartGrid* start = nullptr;
  // [node][block] the largest value or first derivative among harmonics from 4 block + 1 on
  const float* sizes = nullptr;
  std::size_t block_count = 0;
  // Of long even sweeps, else none: the samples of the first step, and every second of the sweep's.
  const SweepBasis *first = nullptr, *half = nullptr;
  StripeShape shape;
  float projector_black_frac = 0;
  bool is_free = true;
  int harmonic_count = 0;  // of the table
  std::array<Noise, kMostNoise> noise{};
  std::size_t noise_count = 0;
};

// Fits all vectors of the batch, up to its count rounded up to 16. Every element of `fit` there is
// written; a pixel's bits do not depend on its neighbours.
//   basis  for the shifts with their shared offsets; not quartered where a pixel has its own
void fit_vectors(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                 BatchFit& fit);

}  // namespace estimation
