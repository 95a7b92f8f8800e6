// BatchFitter against fit_pixel, which the long double reference holds (likelihood_test).
#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <vector>

#include "estimation/profile/gather_samples.h"
#include "likelihood_pixels.h"

namespace estimation {
namespace {

using testing::even_shifts;
using testing::kWhiteDnPerUs;
using testing::Normal;
using testing::Sweep;

constexpr std::size_t kPixels = 320;
constexpr int kHarmonics = 32;
const ShapeRange kTableRange{{-2.2, 0.4}, {1.6, 3.2}};

const HarmonicTable& table() {
  static const HarmonicTable made(Dipole(1.4), {}, kTableRange, kHarmonics);
  return made;
}

enum class Offsets { kNone, kShared, kOwn };

struct Kind {
  const char* name;
  std::vector<int> shifts_px = even_shifts(40);
  IndirectLight indirect = IndirectLight::kFree;
  double light = 1;
  double lost_share = 0;
  Offsets offsets = Offsets::kNone;
  bool is_skewed = false;  // factors with a phase, which oblique light has
};

// Skin from R_d 0.2 to 0.7 and l_d 2.2 to 12 px, seen through half a projector pixel of blur.
struct Pixels {
  Sweep sweep;
  std::vector<float> samples, position_px, full_signal, factor_re, factor_im, offset_px;

  explicit Pixels(const Kind& kind) {
    sweep.shifts_px = kind.shifts_px;
    sweep.indirect = kind.indirect;
    sweep.projector_black_frac = 0.002;
    Normal random(11);
    const std::size_t shift_count = kind.shifts_px.size();
    samples.resize(shift_count * kPixels);
    for (std::size_t i = 0; i < kPixels; ++i) {
      position_px.push_back(static_cast<float>(random.uniform(0, 1024)));
      full_signal.push_back(
          static_cast<float>(kWhiteDnPerUs * kind.light * random.uniform(0.6, 1)));
    }
    for (int n = 0; n <= kHarmonics; ++n)
      for (std::size_t i = 0; i < kPixels; ++i) {
        const double wave = 2 * std::numbers::pi * n / 40;
        const double contrast = 0.97 * std::exp(-0.125 * wave * wave);
        const double turn = kind.is_skewed ? 0.7 * wave * random.uniform(0.9, 1.1) : 0;
        factor_re.push_back(static_cast<float>(contrast * std::cos(turn)));
        factor_im.push_back(static_cast<float>(contrast * std::sin(turn)));
      }
    const std::size_t offset_count = kind.offsets == Offsets::kNone     ? 0
                                     : kind.offsets == Offsets::kShared ? shift_count
                                                                        : shift_count * kPixels;
    for (std::size_t i = 0; i < offset_count; ++i)
      offset_px.push_back(static_cast<float>(0.3 * random.normal()));
    expose(kind, random);
  }

  FitProblem problem() const { return sweep.problem(&table()); }
  PixelBatch batch() const { return batch(samples); }

 private:
  PixelBatch batch(std::span<const float> of) const {
    return {.count = kPixels,
            .stride = kPixels,
            .samples = of,
            .position_px = position_px,
            .full_signal = full_signal,
            .factor_re = factor_re,
            .factor_im = factor_im,
            .factor_count = kHarmonics + 1,
            .offset_px = offset_px};
  }

  void expose(const Kind& kind, Normal& random) {
    for (std::size_t i = 0; i < kPixels; ++i) {
      const PixelTruth truth{
          .shape = {random.uniform(-1.4, 0.85), random.uniform(0.8, 2.5)},
          .indirect = kind.indirect == IndirectLight::kFree ? random.uniform(0, 0.1) : 0,
          .phase_px = random.uniform(-0.5, 0.5)};
      const auto reflectance = expected_reflectance(problem(), batch({}), i, truth);
      for (std::size_t j = 0; j < reflectance.size(); ++j) {
        const double signal = reflectance[j] * static_cast<double>(full_signal[i]);
        const double sd = std::sqrt(variance_at(sweep.noise, signal));
        samples[j * kPixels + i] = random.uniform() < kind.lost_share
                                       ? std::numeric_limits<float>::quiet_NaN()
                                       : static_cast<float>(signal + sd * random.normal());
      }
    }
  }
};

std::array<double, kUnknowns> unknowns(const PixelFit& fit) {
  return {fit.logit_reflectance, fit.log_translucency_px, fit.indirect, fit.phase_px};
}

std::array<float, kUnknowns> unknowns(const BatchFit& fit, std::size_t i) {
  return {fit.logit_reflectance[i], fit.log_translucency_px[i], fit.indirect[i], fit.phase_px[i]};
}

std::vector<Kind> kinds() {
  return {{.name = "40 shifts"},
          {.name = "no indirect light", .indirect = IndirectLight::kZero},
          {.name = "a sixteenth of the light", .light = 1.0 / 16},
          {.name = "skewed factors", .is_skewed = true},
          {.name = "20 shifts", .shifts_px = even_shifts(20)},
          {.name = "10 shifts", .shifts_px = even_shifts(10)},
          {.name = "8 shifts", .shifts_px = even_shifts(8)},
          {.name = "uneven shifts", .shifts_px = {0, 1, 2, 5, 9, 10, 14, 17, 22, 23, 27, 31, 36}},
          {.name = "shuffled shifts", .shifts_px = {30, 5, 25, 0, 15, 35, 10, 20}},
          {.name = "lost samples", .lost_share = 0.04},
          {.name = "shared offsets", .offsets = Offsets::kShared},
          {.name = "offsets of each pixel", .offsets = Offsets::kOwn}};
}

TEST(BatchFitter, AgreesWithFitPixelToAThousandthOfAStandardDeviation) {
  for (const Kind& kind : kinds()) {
    SCOPED_TRACE(kind.name);
    const Pixels pixels(kind);
    const FitProblem problem = pixels.problem();
    BatchFit fit;
    BatchFitter(problem).fit(pixels.batch(), fit);
    double squares = 0, most = 0, most_sd = 0, most_correlation = 0, most_chi_square = 0;
    std::size_t count = 0, unlike = 0, left = 0;
    for (std::size_t i = 0; i < kPixels; ++i) {
      const PixelFit exact = fit_pixel(problem, pixels.batch(), i);
      unlike += exact.validity != fit.validity[i];
      if (exact.validity != 0 || fit.validity[i] != 0) continue;
      bool is_same = true;
      const auto variance = [&](std::size_t k) { return exact.covariance[covariance_index(k, k)]; };
      for (std::size_t k = 0; k < kUnknowns; ++k) {
        const double found = static_cast<double>(unknowns(fit, i)[k]);
        is_same = is_same && unknowns(fit, i)[k] == static_cast<float>(unknowns(exact)[k]);
        if (variance(k) == 0) {
          EXPECT_EQ(found, 0);
          continue;
        }
        const double difference = (found - unknowns(exact)[k]) / std::sqrt(variance(k));
        squares += difference * difference;
        most = std::max(most, std::abs(difference));
        ++count;
        for (std::size_t m = 0; m <= k; ++m) {
          const std::size_t c = covariance_index(k, m);
          const double scale = std::sqrt(variance(k) * variance(m));
          if (scale == 0) continue;
          const double off =
              (static_cast<double>(fit.covariance[c * fit.stride + i]) - exact.covariance[c]) /
              scale;
          double& worst = k == m ? most_sd : most_correlation;
          worst = std::max(worst, std::abs(off));
        }
      }
      left += is_same;
      most_chi_square =
          std::max(most_chi_square, std::abs(static_cast<double>(fit.reduced_chi_square[i]) -
                                             exact.chi_square / exact.degrees_of_freedom));
    }
    EXPECT_GT(count, 3 * kPixels * 9 / 10);
    EXPECT_LE(std::sqrt(squares / static_cast<double>(count)), 1e-3);
    EXPECT_LE(most, 0.02);  // where a sample lies in the middle of a change of exposures
    EXPECT_LE(most_sd, 0.02);
    EXPECT_LE(most_correlation, 0.02);
    EXPECT_LE(most_chi_square, 0.03);
    EXPECT_LE(unlike, 1U);
    EXPECT_LE(left, kPixels / 50);  // fit_pixel is a hundred times as slow
  }
}

// A pixel's place among the lanes, and what its neighbours need, must not show.
TEST(BatchFitter, FactorsThatPixelsShareAreThoseOfEachPixel) {
  Pixels pixels({.name = "40 shifts, lost samples, skewed", .lost_share = 0.01, .is_skewed = true});
  std::vector<float> shared_re, shared_im;
  for (std::size_t n = 0; n <= kHarmonics; ++n) {
    shared_re.push_back(pixels.factor_re[n * kPixels]);
    shared_im.push_back(pixels.factor_im[n * kPixels]);
    std::fill_n(pixels.factor_re.begin() + static_cast<std::ptrdiff_t>(n * kPixels), kPixels,
                shared_re.back());
    std::fill_n(pixels.factor_im.begin() + static_cast<std::ptrdiff_t>(n * kPixels), kPixels,
                shared_im.back());
  }
  const FitProblem problem = pixels.problem();
  PixelBatch batch = pixels.batch();
  BatchFit own, shared;
  fit_batch(problem, batch, own);
  const PixelFit own_pixel = fit_pixel(problem, batch, 7);
  batch.factor_re = shared_re;
  batch.factor_im = shared_im;
  fit_batch(problem, batch, shared);
  EXPECT_EQ(own.validity, shared.validity);
  EXPECT_EQ(std::count(own.validity.begin(), own.validity.end(), 0U),
            static_cast<std::ptrdiff_t>(kPixels));
  for (std::size_t i = 0; i < kPixels; ++i)
    for (std::size_t k = 0; k < kUnknowns; ++k)
      EXPECT_EQ(unknowns(own, i)[k], unknowns(shared, i)[k]);
  EXPECT_EQ(own_pixel.log_translucency_px, fit_pixel(problem, batch, 7).log_translucency_px);
}

TEST(BatchFitter, APixelsBitsDoNotDependOnItsPlace) {
  for (const Kind& kind : kinds()) {
    SCOPED_TRACE(kind.name);
    const Pixels pixels(kind);
    const BatchFitter fitter(pixels.problem());
    BatchFit fit, moved_fit;
    fitter.fit(pixels.batch(), fit);
    Pixels moved = pixels;  // pixel i moves to 7 i mod kPixels, which 7 does not divide
    const auto permute = [](const std::vector<float>& from, std::vector<float>& to) {
      for (std::size_t at = 0; at < from.size(); ++at)
        to[at / kPixels * kPixels + at % kPixels * 7 % kPixels] = from[at];
    };
    permute(pixels.samples, moved.samples);
    permute(pixels.position_px, moved.position_px);
    permute(pixels.full_signal, moved.full_signal);
    permute(pixels.factor_re, moved.factor_re);
    permute(pixels.factor_im, moved.factor_im);
    if (kind.offsets == Offsets::kOwn) permute(pixels.offset_px, moved.offset_px);
    PixelBatch batch = moved.batch();
    batch.count -= 5;  // and a last vector that is not full
    fitter.fit(batch, moved_fit);
    std::size_t compared = 0;
    for (std::size_t i = 0; i < kPixels; ++i) {
      const std::size_t to = i * 7 % kPixels;
      if (to >= batch.count) continue;
      ++compared;
      for (std::size_t k = 0; k < kUnknowns; ++k)
        EXPECT_EQ(std::bit_cast<std::uint32_t>(unknowns(fit, i)[k]),
                  std::bit_cast<std::uint32_t>(unknowns(moved_fit, to)[k]));
      for (std::size_t c = 0; c < 10; ++c)
        EXPECT_EQ(fit.covariance[c * fit.stride + i],
                  moved_fit.covariance[c * moved_fit.stride + to]);
      EXPECT_EQ(fit.reduced_chi_square[i], moved_fit.reduced_chi_square[to]);
      EXPECT_EQ(fit.validity[i], moved_fit.validity[to]);
    }
    EXPECT_EQ(compared, kPixels - 5);
  }
}

// All that the program holds and this machine can do, down to none at all.
TEST(BatchFitter, EveryInstructionSetAgreesToAThousandthOfAStandardDeviation) {
  const auto fit_with = [](const Pixels& pixels, std::int64_t targets) {
    hwy::SetSupportedTargetsForTest(targets);
    hwy::GetChosenTarget().DeInit();
    BatchFit fit;
    BatchFitter(pixels.problem()).fit(pixels.batch(), fit);
    return fit;
  };
  for (const Kind& kind : kinds()) {
    SCOPED_TRACE(kind.name);
    const Pixels pixels(kind);
    const BatchFit best = fit_with(pixels, 0);  // whatever the machine has
    for (std::int64_t targets = hwy::SupportedTargets(); targets != 0; targets &= targets - 1) {
      SCOPED_TRACE(hwy::TargetName(targets & -targets));
      const BatchFit fit = fit_with(pixels, targets & -targets);
      double squares = 0;
      std::size_t unlike = 0;
      for (std::size_t i = 0; i < kPixels; ++i) {
        unlike += fit.validity[i] != best.validity[i];
        if (fit.validity[i] != 0 || best.validity[i] != 0) continue;
        const double difference = static_cast<double>(fit.log_translucency_px[i]) -
                                  static_cast<double>(best.log_translucency_px[i]);
        squares += difference * difference /
                   static_cast<double>(best.covariance[covariance_index(1, 1) * best.stride + i]);
      }
      EXPECT_LE(std::sqrt(squares / kPixels), 1e-3);
      EXPECT_LE(unlike, 1U);
    }
    fit_with(pixels, 0);
  }
}

TEST(BatchFitter, LimitsTheHarmonicsOfTheDataAsFitPixelDoes) {
  const Pixels pixels({.name = "40 shifts"});
  FitProblem problem = pixels.problem();
  problem.harmonic_count = 3;
  BatchFit fit;
  BatchFitter(problem).fit(pixels.batch(), fit);
  double misfit = 0;
  for (std::size_t i = 0; i < kPixels; ++i) {
    const PixelFit exact = fit_pixel(problem, pixels.batch(), i);
    ASSERT_EQ(exact.validity, fit.validity[i]);
    if (exact.validity != 0) continue;
    EXPECT_EQ(exact.degrees_of_freedom, 3);  // seven numbers, four unknowns
    EXPECT_EQ(static_cast<float>(exact.log_translucency_px), fit.log_translucency_px[i]);
    misfit += exact.chi_square / exact.degrees_of_freedom / kPixels;
  }
  EXPECT_NEAR(misfit, 1, 0.15);  // what the model has beyond is not missed
}

TEST(GatherSamples, CopiesRunsAndSingleElementsAlike) {
  std::vector<Image<float>> images;
  std::vector<ImageView<const float>> views;
  for (int i = 0; i < 3; ++i) {
    images.emplace_back(40, 50);
    for (std::size_t at = 0; at < images.back().samples().size(); ++at)
      images.back().samples()[at] = static_cast<float>(10000 * i) + static_cast<float>(at);
  }
  for (const Image<float>& image : images) views.push_back(image.view());
  std::vector<std::uint32_t> elements;
  for (std::uint32_t at = 3; at < 60; ++at) elements.push_back(at);        // neighbours
  for (std::uint32_t at = 101; at < 221; at += 2) elements.push_back(at);  // every second
  for (std::uint32_t at = 300; at < 1999; at += 1 + at % 3) elements.push_back(at);
  const std::size_t stride = (elements.size() + 15) / 16 * 16 + 16;
  std::vector<float> samples(3 * stride, -1.0F);
  gather_samples(views, elements, stride, samples);
  for (std::size_t image = 0; image < 3; ++image)
    for (std::size_t i = 0; i < stride; ++i) {
      const float expected = i < elements.size() ? static_cast<float>(10000 * image + elements[i])
                             : i < stride - 16   ? 0.0F
                                                 : -1.0F;
      EXPECT_EQ(samples[image * stride + i], expected);
    }
}

}  // namespace
}  // namespace estimation
