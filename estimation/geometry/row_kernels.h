// The arithmetic of one image row of signals, by vectors of pixels.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "estimation/geometry/phase.h"
#include "estimation/geometry/signal_rows.h"

namespace estimation {

// MergedNoise in single precision.
struct NoiseRange {
  float up_to_dn_per_us = 0, read_variance = 0, shot_dn_per_us = 0;
};

// What every kernel needs to know of the samples.
struct SampleNoise {
  std::span<const NoiseRange> ranges;  // at least one
  float saturation_dn = 0;             // of frames
};

// Of a pattern and its inverse, over [0, width). A sample that is lost counts as lit beside one
// that is not: its bit is infinite with no variance.
struct PairRow {
  float* value = nullptr;     // plain minus inverse, DN/us; NaN where both are lost
  float* variance = nullptr;  // of that
  // Brought up to date where this pair is the clearest so far.
  float* contrast = nullptr;
  float* contrast_variance = nullptr;
  float* lost = nullptr;  // becomes NaN where a sample is lost
};
void read_pair(const SampleRow& plain, const SampleRow& inverse, const SampleNoise& noise,
               std::size_t width, const PairRow& out);

// A phase family's first harmonic over [begin, end).
struct FamilyWeights {
  std::span<const float> mean, cosine, sine;  // [shift]
  float aliasing_px = 0;
  float centre_px = 0, px_per_rad = 0;
  float modulation_scale = 0;  // white minus black over the amplitude
};
struct PhaseRow {
  float *position_px = nullptr, *sd_px = nullptr;  // NaN and infinity: no phase
  float *modulation = nullptr, *modulation_sd = nullptr;
  float* mean = nullptr;
  float* lost =
      nullptr;  // becomes NaN where a sample is lost; the other results mean nothing there
};
void read_phases(std::span<const SampleRow> shifts, const SampleNoise& noise,
                 const FamilyWeights& weights, std::size_t begin, std::size_t end,
                 const PhaseRow& out);

// Sums over the shifts with six sets of weights, [set][shift] to [set][col], over [begin, end); NaN
// where a sample is lost.
inline constexpr std::size_t kWeightSets = 6;
struct WeightedSums {
  std::array<std::span<const float>, kWeightSets> weights;
  std::array<float*, kWeightSets> out{};
};
void sum_shifts(std::span<const SampleRow> shifts, float saturation_dn, std::size_t begin,
                std::size_t end, const WeightedSums& sums);

// An amplitude below this many standard deviations has no phase worth the name.
inline constexpr float kMinAmplitudeSd = 3;

}  // namespace estimation
