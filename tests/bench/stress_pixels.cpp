#include "tests/bench/stress_pixels.h"

#include <oneapi/tbb/parallel_for.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "tests/bench/pixels.h"

namespace bench {
namespace {

using estimation::IndirectLight;
using estimation::truth::PixelRandom;
using estimation::truth::Sensor;
using std::numbers::pi;

constexpr std::size_t kMaterials = 4096, kPhases = 320;
constexpr int kPeriodPx = 40, kWidthPx = 8, kHarmonics = 120;
constexpr double kDuty = static_cast<double>(kWidthPx) / kPeriodPx;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Even in the logarithm of what is left to 0 and to 1: R_d from 1e-6 to 1 - 1e-9.
double random_reflectance(PixelRandom& random) {
  const double logit = std::lerp(std::log(1e-6), std::log(1e9), random.uniform());
  return 1 / (1 + std::exp(-logit));
}

std::vector<int> uneven_shifts() { return {0, 1, 2, 7, 11, 12, 18, 19, 23, 29, 31, 38}; }

std::vector<StressSweep> all_sweeps() {
  const auto noise = Sensor{}.noise();
  const std::vector<estimation::MergedNoise> one_exposure{noise.back()};
  std::vector<StressSweep> sweeps;
  for (const IndirectLight indirect : {IndirectLight::kFree, IndirectLight::kZero}) {
    for (const int count : {40, 20, 10, 8, 5, 4})
      sweeps.push_back({.name = std::to_string(count) + " shifts",
                        .shifts_px = even_shifts(kPeriodPx, count),
                        .noise = noise,
                        .indirect = indirect});
    sweeps.push_back({.name = "40 shifts, projector black",
                      .shifts_px = even_shifts(kPeriodPx, 40),
                      .noise = one_exposure,
                      .projector_black_frac = 0.01,
                      .indirect = indirect});
    sweeps.push_back(
        {.name = "uneven", .shifts_px = uneven_shifts(), .noise = noise, .indirect = indirect});
    sweeps.push_back({.name = "one shift", .shifts_px = {3}, .noise = noise, .indirect = indirect});
    sweeps.push_back({.name = "one shift nine times",
                      .shifts_px = std::vector<int>(9, 5),
                      .noise = noise,
                      .indirect = indirect});
    sweeps.push_back({.name = "two shifts, repeated",
                      .shifts_px = {0, 20, 0, 20, 0, 20, 0, 20},
                      .noise = noise,
                      .indirect = indirect});
  }
  return sweeps;
}

}  // namespace

StressPixels::StressPixels()
    : table_(std::make_unique<estimation::HarmonicTable>(dipole_, estimation::StripeShape{},
                                                         estimation::ShapeRange{}, 40)),
      sweeps_(all_sweeps()),
      curves_(kMaterials * kPhases) {
  for (const StressSweep& sweep : sweeps_)
    problems_.push_back({.shape = {},
                         .shifts_px = sweep.shifts_px,
                         .noise = sweep.noise,
                         .projector_black_frac = sweep.projector_black_frac,
                         .model = &dipole_,
                         .table = table_.get(),
                         .harmonic_count = 0,
                         .indirect = sweep.indirect});
  for (const estimation::FitProblem& problem : problems_) fitters_.emplace_back(problem);
  std::vector<double> cosine;
  for (std::size_t phase = 0; phase < kPhases; ++phase)
    cosine.push_back(std::cos(2 * pi * static_cast<double>(phase) / kPhases));
  tbb::parallel_for(std::size_t{0}, kMaterials, [&](std::size_t material) {
    PixelRandom random(material);
    const double reflectance = random_reflectance(random);
    const double l_d_px = std::exp(std::lerp(std::log(1e-3), std::log(1e3), random.uniform()));
    std::vector<double> k_times_l_d, transform(kHarmonics + 1);
    for (int n = 0; n <= kHarmonics; ++n) k_times_l_d.push_back(2 * pi * n / kPeriodPx * l_d_px);
    dipole_.transform(reflectance, k_times_l_d, transform);
    for (int n = 1; n <= kHarmonics; ++n)
      transform[static_cast<std::size_t>(n)] *= 2 * std::sin(pi * n * kDuty) / (pi * n);
    for (std::size_t phase = 0; phase < kPhases; ++phase) {
      double sum = kDuty * transform[0];
      for (std::size_t n = 1; n <= kHarmonics; ++n)
        sum += transform[n] * cosine[n * phase % kPhases];
      curves_[material * kPhases + phase] = static_cast<float>(sum);
    }
  });
}

estimation::PixelBatch StressPixels::make(std::uint64_t batch, Buffers& buffers) const {
  const StressSweep& wanted = sweep(batch);
  buffers.samples.resize(wanted.shifts_px.size() * kCount);
  buffers.position_px.resize(kCount);
  buffers.full_signal.resize(kCount);
  PixelRandom random(batch * 0x2545f4914f6cdd1dU + 17);
  for (std::size_t pixel = 0; pixel < kCount; ++pixel) make_pixel(wanted, pixel, random, buffers);
  return {.count = kCount,
          .stride = kCount,
          .samples = buffers.samples,
          .position_px = buffers.position_px,
          .full_signal = buffers.full_signal,
          .factor_re = {},
          .factor_im = {},
          .factor_count = 0,
          .offset_px = {}};
}

// A material out of the pool at a random place, with noise; one pixel in four is then damaged.
void StressPixels::make_pixel(const StressSweep& sweep, std::size_t pixel, PixelRandom& random,
                              Buffers& buffers) const {
  const Sensor sensor;
  const std::uint64_t dice = random();
  const float* curve = curves_.data() + (dice % kMaterials) * kPhases;
  const std::size_t phase = (dice >> 16) % kPhases;
  const double centre_px = 0.5 * (kWidthPx - 1);
  const double position_px =
      static_cast<double>(phase) / 8 + centre_px + 40 * static_cast<double>((dice >> 32) % 16);
  // Light from none to saturation: the brightest reflector at 1/1000 to 10 of the sensor's white.
  const double light = sensor.full_signal_dn_per_us() *
                       std::exp(std::lerp(std::log(1e-3), std::log(10), random.uniform()));
  const double indirect = (dice >> 40) % 2 == 0 ? 0 : 0.3 * random.uniform() - 0.05;
  const double headroom_dn_per_us = (sensor.saturation_dn - sensor.black_dn) / sensor.short_us;
  buffers.position_px[pixel] = static_cast<float>(position_px);
  buffers.full_signal[pixel] = static_cast<float>(light);
  const std::size_t count = sweep.shifts_px.size();
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t at =
        (phase + kPhases - static_cast<std::size_t>(sweep.shifts_px[i]) * 8) % kPhases;
    const double signal =
        light * (static_cast<double>(curve[at]) + kDuty * indirect + sweep.projector_black_frac);
    const double sd = std::sqrt(variance_at(sweep.noise, signal));
    const double seen = signal + sd * (3.46 * (random.uniform() - 0.5));
    buffers.samples[i * kCount + pixel] =
        seen < headroom_dn_per_us ? static_cast<float>(seen) : kNan;
  }
  if ((dice >> 44) % 4 != 0) return;
  float* const first = buffers.samples.data() + pixel;
  const auto sample = [&](std::uint64_t i) -> float& { return first[(i % count) * kCount]; };
  static constexpr float kStrange[] = {kNan,  kInfinity, -kInfinity, -1e3F, 0,      1e-42F,
                                       1e30F, -1e30F,    1e10F,      -0.0F, 1e-20F, 3.4e38F};
  const float strange = kStrange[(dice >> 48) % std::size(kStrange)];
  switch ((dice >> 52) % 8) {
    case 0:
      sample(dice >> 56) = strange;
      break;
    case 1:
      for (std::size_t i = 0; i < count; ++i) sample(i) = strange;
      break;
    case 2:  // all equal
      for (std::size_t i = 0; i < count; ++i) sample(i) = sample(0);
      break;
    case 3:  // a single one
      for (std::size_t i = 1; i < count; ++i) sample(i) = kNan;
      break;
    case 4:
      buffers.full_signal[pixel] = strange;
      break;
    case 5:
      buffers.position_px[pixel] = strange;
      break;
    case 6:  // some lost
      for (std::size_t i = 0; i < count; i += 1 + (dice >> 56) % 5) sample(i) = kNan;
      break;
    default:  // darkness, or the opposite of stripes
      for (std::size_t i = 0; i < count; ++i) sample(i) = (dice >> 56) % 2 == 0 ? 0 : -sample(i);
  }
}

}  // namespace bench
