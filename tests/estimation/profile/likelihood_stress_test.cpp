// Random pixels at and beyond every limit through fit_batch: what is called valid has to be finite
// and possible, and the same bits on any number of threads. Ten million of the benchmark's pixels,
// of any material; fewer from where there is something to be found, looked at more closely.
//   likelihood_stress_test [--pixels=N]   of the latter, default kLikelyPixels
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>

#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/session/maps.h"
#include "likelihood_pixels.h"
#include "tests/bench/stress_tally.h"

namespace estimation {
namespace {

using testing::even_shifts;
using testing::kWhiteDnPerUs;
using testing::Normal;
using testing::Sweep;

constexpr std::int64_t kLikelyPixels = 200'000;
constexpr std::uint64_t kAnyPixels = 10'000'000;

std::int64_t pixel_count = kLikelyPixels;

constexpr std::size_t kBatch = 512;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// The first harmonics of a material's profile under the paper's stripes; sharper ones are cut off,
// which a fit has to survive, too.
class Profile {
 public:
  Profile(const Dipole& model, double reflectance, double log_translucency_px)
      : mean_(0.2 * reflectance) {
    std::array<double, 12> waves{};
    for (std::size_t n = 0; n < waves.size(); ++n)
      waves[n] = kWave * static_cast<double>(n + 1) * std::exp(log_translucency_px);
    model.transform(reflectance, waves, harmonics_);
    for (std::size_t n = 0; n < waves.size(); ++n) {
      const double angle = std::numbers::pi * static_cast<double>(n + 1);
      harmonics_[n] *= 2 * std::sin(0.2 * angle) / angle;
    }
  }
  // At this distance from the stripe's middle, by Clenshaw's recurrence.
  double at(double distance_px) const {
    const double cosine = std::cos(kWave * distance_px);
    double next = 0, after = 0;
    for (std::size_t n = harmonics_.size(); n-- > 0;) {
      const double current = harmonics_[n] + 2 * cosine * next - after;
      after = next;
      next = current;
    }
    return mean_ + cosine * next - after;
  }

 private:
  static constexpr double kWave = 2 * std::numbers::pi / 40;
  double mean_;
  std::array<double, 12> harmonics_{};
};

// A batch of one set of shifts and its pixels' data.
struct Batch {
  std::vector<float> samples, position_px, full_signal;

  PixelBatch view() const {
    PixelBatch view;
    view.count = view.stride = kBatch;
    view.samples = samples;
    view.position_px = position_px;
    view.full_signal = full_signal;
    return view;
  }
};

// How a pixel's samples are spoiled after they were made.
enum class Spoil {
  kNothing,
  kOneSample,
  kAllEqual,
  kSomeLost,
  kInfinite,
  kNegative,
  kHuge,
  kBlinded
};

void spoil(std::vector<float>& samples, std::size_t pixel, Spoil how, Normal& random) {
  const std::size_t count = samples.size() / kBatch;
  const auto any = [&] {
    return kBatch * static_cast<std::size_t>(random.uniform(0, static_cast<double>(count))) + pixel;
  };
  const std::size_t kept = any();
  for (std::size_t j = 0; j < count; ++j) {
    float& sample = samples[j * kBatch + pixel];
    if (how == Spoil::kOneSample && j * kBatch + pixel != kept) sample = kNan;
    if (how == Spoil::kAllEqual) sample = samples[pixel];
    if (how == Spoil::kSomeLost && random.uniform() < 0.3) sample = kNan;
    if (how == Spoil::kNegative) sample = -sample;
    if (how == Spoil::kBlinded && sample > 0.3F) sample = kNan;
  }
  if (how == Spoil::kInfinite) samples[any()] = random.uniform() < 0.5 ? kInfinity : -kInfinity;
  if (how == Spoil::kHuge) samples[any()] = static_cast<float>(std::pow(10, random.uniform(0, 38)));
}

Batch random_batch(const Sweep& sweep, std::uint64_t seed) {
  Normal random(seed);
  const std::size_t count = sweep.shifts_px.size();
  Batch batch{.samples = std::vector<float>(count * kBatch),
              .position_px = std::vector<float>(kBatch),
              .full_signal = std::vector<float>(kBatch)};
  for (std::size_t i = 0; i < kBatch; ++i) {
    // R_d evenly in its logit from 1e-6 to 1 - 1e-9, l_d in its logarithm from 1e-3 to 1e3 px; most
    // from where there is something to be found: that can go wrong in more ways.
    const bool is_far = random.uniform() < 0.1;
    const double logit = is_far ? random.uniform(-13.8, 20.7) : random.uniform(-4, 3);
    const double log_px = is_far ? random.uniform(-6.9, 6.9) : random.uniform(0.3, 3.5);
    const Profile profile(sweep.model, 1 / (1 + std::exp(-logit)), log_px);
    const double full = kWhiteDnPerUs * std::pow(10, random.uniform(-3, 0.2));
    const double position_px = random.uniform(0, 1024), phase_px = random.uniform(-1.5, 1.5);
    const double indirect = random.uniform() < 0.5 ? 0 : random.uniform(-0.05, 0.2);
    const bool is_noisy = random.uniform() < 0.9;
    for (std::size_t j = 0; j < count; ++j) {
      const double distance_px = position_px + phase_px - sweep.shifts_px[j] - 3.5;
      const double signal = full * (0.2 * indirect + profile.at(distance_px));
      const double sd = is_noisy ? std::sqrt(variance_at(sweep.noise, signal)) : 0;
      batch.samples[j * kBatch + i] = static_cast<float>(signal + sd * random.normal());
    }
    batch.position_px[i] = static_cast<float>(position_px);
    batch.full_signal[i] = static_cast<float>(full);
    if (random.uniform() < 0.2)
      spoil(batch.samples, i, static_cast<Spoil>(static_cast<int>(random.uniform(0, 8))), random);
    if (random.uniform() < 0.01) {
      constexpr std::array<float, 5> kBad = {0, -1, kNan, kInfinity, 1e-38F};
      batch.full_signal[i] = kBad[static_cast<std::size_t>(random.uniform(0, 5))];
    }
    if (random.uniform() < 0.005) batch.position_px[i] = random.uniform() < 0.5 ? kNan : kInfinity;
  }
  return batch;
}

constexpr std::uint32_t kFitErrors = kSaturated | kTooDark | kOutsideModel | kNotIdentifiable;

// What is wrong with a valid pixel; empty if nothing is.
std::string fault_of(const BatchFit& fit, std::size_t i, bool is_free) {
  const std::uint32_t validity = fit.validity[i];
  if ((validity & ~kFitErrors) != 0) return "an unknown reason";
  if (validity != 0) return {};
  for (const auto* row : {&fit.logit_reflectance, &fit.log_translucency_px, &fit.indirect,
                          &fit.phase_px, &fit.reduced_chi_square})
    if (!std::isfinite((*row)[i])) return "a value that is not finite";
  if (fit.reduced_chi_square[i] < 0) return "a negative chi-square";
  std::array<double, 10> covariance{};
  for (std::size_t k = 0; k < covariance.size(); ++k) {
    covariance[k] = static_cast<double>(fit.covariance[k * fit.stride + i]);
    if (!std::isfinite(covariance[k])) return "a covariance that is not finite";
  }
  for (std::size_t a = 0; a < kUnknowns; ++a) {
    const double variance = covariance[covariance_index(a, a)];
    const bool is_fixed = a == 2 && !is_free;
    if (is_fixed ? variance != 0 : !(variance > 0)) return "a variance of no sense";
    for (std::size_t b = 0; b < a; ++b)
      if (std::abs(covariance[covariance_index(a, b)]) >
          1.001 * std::sqrt(variance * covariance[covariance_index(b, b)]))
        return "a correlation above one";
  }
  if (!(covariance[covariance_index(1, 1)] <= 0.2501)) return "l_d without being known";
  return {};
}

struct Kind {
  const char* name;
  std::vector<int> shifts_px;
  IndirectLight indirect = IndirectLight::kFree;
  double share = 0;  // of all pixels
};

std::vector<Kind> kinds() {
  return {{"40 shifts", even_shifts(40), IndirectLight::kFree, 0.55},
          {"40 shifts, no indirect light", even_shifts(40), IndirectLight::kZero, 0.2},
          {"10 shifts", even_shifts(10), IndirectLight::kFree, 0.1},
          {"8 shifts", even_shifts(8), IndirectLight::kFree, 0.1},
          {"uneven shifts", {0, 1, 2, 5, 9, 10, 17, 22, 23, 31}, IndirectLight::kFree, 0.03},
          {"duplicate shifts", {0, 0, 8, 8, 16, 16, 24, 24}, IndirectLight::kFree, 0.01},
          {"one shift many times", {7, 7, 7, 7, 7, 7}, IndirectLight::kFree, 0.005},
          {"one shift", {7}, IndirectLight::kZero, 0.005}};
}

const HarmonicTable& wide_table() {
  static const HarmonicTable table(Dipole(1.4), {}, {{-4.5, -0.5}, {3.5, 4}}, 48);
  return table;
}

TEST(LikelihoodStress, TenMillionOfAnyMaterial) {
  const bench::StressPixels pixels;
  const std::uint64_t batches =
      (kAnyPixels + bench::StressPixels::kCount - 1) / bench::StressPixels::kCount;
  const bench::StressTally tally = bench::stress(pixels, 0, batches);
  EXPECT_GE(tally.pixels, kAnyPixels);
  EXPECT_GT(tally.valid, kAnyPixels / 20);
  EXPECT_EQ(tally.not_finite, 0U);
  EXPECT_EQ(tally.negative_sigma, 0U);
}

TEST(LikelihoodStress, NothingImpossibleIsCalledValid) {
  std::atomic<std::int64_t> valid = 0, faults = 0;
  for (const Kind& kind : kinds()) {
    SCOPED_TRACE(kind.name);
    Sweep sweep;
    sweep.shifts_px = kind.shifts_px;
    sweep.indirect = kind.indirect;
    const BatchFitter fitter(sweep.problem(&wide_table()));
    const auto batches = static_cast<std::int64_t>(
        std::ceil(static_cast<double>(pixel_count) * kind.share / kBatch));
    tbb::parallel_for(std::int64_t{0}, batches, [&](std::int64_t index) {
      const Batch batch = random_batch(sweep, static_cast<std::uint64_t>(index) * 8 + 1);
      BatchFit fit;
      fit.resize(kBatch);
      fitter.fit(batch.view(), fit);
      for (std::size_t i = 0; i < kBatch; ++i) {
        const std::string fault = fault_of(fit, i, kind.indirect == IndirectLight::kFree);
        valid += fit.validity[i] == 0;
        if (fault.empty() || ++faults > 10) continue;
        ADD_FAILURE() << kind.name << ", batch " << index << ", pixel " << i << ": " << fault;
      }
    });
  }
  EXPECT_EQ(faults, 0);
  EXPECT_GT(static_cast<double>(valid), 0.3 * static_cast<double>(pixel_count));
  RecordProperty("valid_frac",
                 std::to_string(static_cast<double>(valid) / static_cast<double>(pixel_count)));
}

// A checksum of all bits of a fit.
std::uint64_t bits_of(const BatchFit& fit) {
  std::uint64_t sum = 14695981039346656037ULL;
  const auto add = [&](std::uint32_t value) { sum = (sum ^ value) * 1099511628211ULL; };
  for (const auto* row : {&fit.logit_reflectance, &fit.log_translucency_px, &fit.indirect,
                          &fit.phase_px, &fit.reduced_chi_square, &fit.covariance})
    for (const float value : *row) add(std::bit_cast<std::uint32_t>(value));
  for (const std::uint32_t value : fit.validity) add(value);
  return sum;
}

TEST(LikelihoodStress, TheSameBitsOnAnyNumberOfThreads) {
  const Sweep sweep;
  constexpr std::size_t kBatches = 16;
  std::vector<std::uint64_t> expected;
  for (const std::size_t threads : {1UL, 2UL, 3UL, 4UL}) {
    const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    const HarmonicTable table(sweep.model, {}, {{-4.5, -0.5}, {3.5, 4}}, 16);
    const BatchFitter fitter(sweep.problem(&table));
    std::vector<std::uint64_t> found(kBatches);
    tbb::parallel_for(std::size_t{0}, kBatches, [&](std::size_t index) {
      const Batch batch = random_batch(sweep, index);
      BatchFit fit;
      fit.resize(kBatch);
      fitter.fit(batch.view(), fit);
      found[index] = bits_of(fit);
    });
    if (expected.empty()) expected = found;
    EXPECT_EQ(found, expected) << threads << " threads";
  }
}

}  // namespace
}  // namespace estimation

int main(int argc, char** argv) {
  ::testing::InitGoogleTest(&argc, argv);
  constexpr std::string_view kOption = "--pixels=";
  for (int i = 1; i < argc; ++i)
    if (std::string_view(argv[i]).starts_with(kOption))
      estimation::pixel_count = std::stoll(argv[i] + kOption.size());
  return RUN_ALL_TESTS();
}
