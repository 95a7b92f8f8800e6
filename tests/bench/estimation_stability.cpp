// Numerical stability: pixels at random over everything that could come in, the same bits for any
// number of threads, and error against conditioning.
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <optional>

#include "estimation/session/maps.h"
#include "tests/bench/estimation_bench.h"
#include "tests/bench/figure.h"
#include "tests/bench/methods.h"
#include "tests/bench/stress_pixels.h"
#include "tests/bench/stress_tally.h"
#include "tests/estimation/profile/likelihood_reference.h"

namespace bench {
namespace {

using estimation::BatchFit;
using estimation::covariance_index;
using estimation::kUnknowns;
namespace reference = estimation::testing;

// Condition of the covariance, scaled to a unit diagonal.
double condition_of(const std::array<long double, 10>& covariance) {
  cv::Matx44d scaled;
  for (std::size_t row = 0; row < kUnknowns; ++row)
    for (std::size_t col = 0; col < kUnknowns; ++col) {
      const auto at = [&](std::size_t a, std::size_t b) {
        return covariance[covariance_index(a, b)];
      };
      scaled(static_cast<int>(row), static_cast<int>(col)) =
          static_cast<double>(at(row, col) / std::sqrt(at(row, row) * at(col, col)));
    }
  cv::Vec4d values;
  cv::eigen(scaled, values);
  return values[0] / std::max(values[3], 1e-16);
}

// A projector's stripes are no sharper than an eighth of a pixel: fit_pixel's model, too, ends
// there.
constexpr std::size_t kHarmonicsPerPx = 8;

// The same pixel in long double, from the float's result on.
std::optional<reference::ReferenceFit> reference_of(const estimation::FitProblem& problem,
                                                    const estimation::PixelBatch& data,
                                                    const BatchFit& fit, std::size_t i) {
  reference::ReferencePixel pixel;
  std::vector<float> samples;
  for (std::size_t shift = 0; shift < problem.shifts_px.size(); ++shift) {
    pixel.shifts_px.push_back(problem.shifts_px[shift]);
    samples.push_back(data.samples[shift * data.stride + i]);
  }
  pixel.black_frac = static_cast<long double>(problem.projector_black_frac);
  pixel.position_px = static_cast<long double>(data.position_px[i]);
  pixel.full_signal = static_cast<long double>(data.full_signal[i]);
  pixel.noise.assign(problem.noise.begin(), problem.noise.end());
  pixel.factors.assign(kHarmonicsPerPx * static_cast<std::size_t>(pixel.period_px) + 1, 1);
  return reference_fit(pixel, samples,
                       {.logit = static_cast<long double>(fit.logit_reflectance[i]),
                        .log_translucency_px = static_cast<long double>(fit.log_translucency_px[i]),
                        .indirect = static_cast<long double>(fit.indirect[i]),
                        .phase_px = static_cast<long double>(fit.phase_px[i])},
                       problem.indirect == estimation::IndirectLight::kFree);
}

struct Comparison {
  std::vector<Point> by_vectors, in_double;  // condition, error in standard deviations
  std::size_t without_reference = 0;
};

double error_in_sd(const reference::ReferenceFit& truth, double logit, double log_l,
                   double indirect, double phase_px) {
  const double found[kUnknowns] = {logit, log_l, indirect, phase_px};
  const long double exact[kUnknowns] = {truth.point.logit, truth.point.log_translucency_px,
                                        truth.point.indirect, truth.point.phase_px};
  double worst = 0;
  for (std::size_t k = 0; k < kUnknowns; ++k)
    if (truth.sd[k] > 0)
      worst = std::max(worst, std::abs(found[k] - static_cast<double>(exact[k])) /
                                  static_cast<double>(truth.sd[k]));
  return worst;
}

// A profile far narrower than a projector pixel takes the long double thousands of harmonics.
constexpr float kLeastLogTranslucencyPx = -2;
constexpr std::size_t kOfABatch = 20;  // pixels compared

Comparison compare_batch(const estimation::FitProblem& problem, const estimation::PixelBatch& data,
                         const BatchFit& fit) {
  Comparison comparison;
  std::size_t taken = 0;
  for (std::size_t i = 0; i < data.count && taken < kOfABatch; ++i) {
    if ((fit.validity[i] & estimation::kValidityErrors) != 0 ||
        fit.log_translucency_px[i] < kLeastLogTranslucencyPx)
      continue;
    ++taken;
    const auto truth = reference_of(problem, data, fit, i);
    if (!truth || !std::isfinite(truth->sd[0])) {
      ++comparison.without_reference;
      continue;
    }
    const double condition = condition_of(truth->covariance);
    const auto d = [](float value) { return static_cast<double>(value); };
    comparison.by_vectors.push_back(
        {condition, error_in_sd(*truth, d(fit.logit_reflectance[i]), d(fit.log_translucency_px[i]),
                                d(fit.indirect[i]), d(fit.phase_px[i]))});
    const estimation::PixelFit exact = fit_pixel(problem, data, i);
    if (exact.validity == 0)
      comparison.in_double.push_back(
          {condition, error_in_sd(*truth, exact.logit_reflectance, exact.log_translucency_px,
                                  exact.indirect, exact.phase_px)});
  }
  return comparison;
}

Comparison joined(const std::vector<Comparison>& parts) {
  Comparison all;
  for (const Comparison& part : parts) {
    all.by_vectors.insert(all.by_vectors.end(), part.by_vectors.begin(), part.by_vectors.end());
    all.in_double.insert(all.in_double.end(), part.in_double.begin(), part.in_double.end());
    all.without_reference += part.without_reference;
  }
  return all;
}

// Valid ones of the random pixels.
Comparison compare_random(const StressPixels& pixels, std::size_t batch_count) {
  std::vector<Comparison> parts(batch_count);
  tbb::parallel_for(std::size_t{0}, batch_count, [&](std::size_t batch) {
    if (pixels.sweep(batch).indirect != estimation::IndirectLight::kFree) return;
    StressPixels::Buffers buffers;
    BatchFit fit;
    const estimation::PixelBatch data = pixels.make(batch, buffers);
    pixels.fitter(batch).fit(data, fit);
    parts[batch] = compare_batch(pixels.problem(batch), data, fit);
  });
  return joined(parts);
}

// Skin in the light and noise of design/estimation.md.
Comparison compare_skin(Bench& bench, std::size_t batch_count) {
  constexpr std::size_t kBlock = 32;
  const estimation::Dipole dipole(kEta);
  const PixelSet pixels = simulate(bench.plan(0.3, 0.02, 40, 1, batch_count * kBlock));
  const estimation::HarmonicTable table = harmonic_table(dipole, pixels);
  const estimation::FitProblem problem{.shape = pixels.shape,
                                       .shifts_px = pixels.shifts_px,
                                       .noise = pixels.noise,
                                       .model = &dipole,
                                       .table = &table};
  const estimation::BatchFitter fitter(problem);
  std::vector<Comparison> parts(batch_count);
  tbb::parallel_for(std::size_t{0}, batch_count, [&](std::size_t batch) {
    BatchFit fit;
    const estimation::PixelBatch data = pixels.batch(batch * kBlock, kBlock);
    fitter.fit(data, fit);
    parts[batch] = compare_batch(problem, data, fit);
  });
  return joined(parts);
}

std::string share_below(const std::vector<Point>& points, double limit) {
  const auto count = std::count_if(points.begin(), points.end(),
                                   [&](const Point& point) { return point.y < limit; });
  return percent(static_cast<double>(count) / static_cast<double>(points.size()), 2);
}

double worst(const std::vector<Point>& points) {
  double greatest = 0;
  for (const Point& point : points) greatest = std::max(greatest, point.y);
  return greatest;
}

void show_stress(Bench& bench, const StressPixels& pixels) {
  const std::size_t count = bench.stress_count > 0 ? bench.stress_count
                            : bench.is_quick       ? 100'000
                                                   : 10'000'000;
  const StressCount counted =
      stress_with_progress(pixels, (count + StressPixels::kCount - 1) / StressPixels::kCount,
                           bench.report.folder() / "stress_progress.txt");
  const StressTally& tally = counted.tally;
  if (tally.not_finite + tally.negative_sigma > 0)
    bench.report.fail("A valid pixel is not finite, or a sigma of one is not positive.");
  const auto text = [](std::uint64_t number) { return std::to_string(number); };
  bench.report.table(
      {.name = "stability",
       .title = "Random pixels: R_d 1e-6 to 1 - 1e-9, l_d/pitch 1e-3 to 1e3, light from none to "
                "saturation, 22 sweeps (1 to 40 shifts, even, uneven, repeated), a quarter damaged "
                "(NaN, infinity, negative, all equal, a single sample, no light)",
       .columns = {"pixels", "valid", "NaN or infinity in a valid one", "sigma not positive",
                   "saturated", "too dark", "outside the model", "not identifiable", "seconds"},
       .rows = {{text(tally.pixels), text(tally.valid), text(tally.not_finite),
                 text(tally.negative_sigma), text(tally.saturated), text(tally.too_dark),
                 text(tally.outside), text(tally.not_identifiable), digits(counted.seconds)}}});
}

void show_bits(Bench& bench, const StressPixels& pixels) {
  std::string text = "The same bits for 1, 2, 3 and 4 threads: ";
  std::optional<std::uint64_t> first;
  bool is_same = true;
  for (int threads = 1; threads <= 4; ++threads) {
    std::uint64_t bits = 0;
    tbb::task_arena(threads).execute(
        [&] { bits = stress(pixels, 0, bench.is_quick ? 66 : 440).bits; });
    is_same = is_same && bits == first.value_or(bits);
    first = bits;
  }
  bench.report.text(text.append(is_same ? "yes." : "NO."));
}

std::vector<std::string> comparison_row(const char* name, const Comparison& comparison) {
  return {name,
          std::to_string(comparison.by_vectors.size()),
          share_below(comparison.by_vectors, 1e-3),
          share_below(comparison.by_vectors, 1e-2),
          digits(worst(comparison.by_vectors), 2),
          share_below(comparison.in_double, 1e-3),
          digits(worst(comparison.in_double), 2),
          std::to_string(comparison.without_reference)};
}

}  // namespace

void show_stability(Bench& bench) {
  const StressPixels pixels;
  show_stress(bench, pixels);
  show_bits(bench, pixels);
  const Comparison skin = compare_skin(bench, bench.is_quick ? 8 : 48);
  const Comparison random = compare_random(pixels, bench.is_quick ? 22 : 220);
  bench.report.table(
      {.name = "stability_reference",
       .title = "Against a fit in long double (tests/estimation/profile/likelihood_reference.h): "
                "greatest error of t, ln l_d, B and phase in their standard deviations",
       .columns = {"pixels", "compared", "float vectors: % below 1e-3", "% below 1e-2", "worst",
                   "double by samples: % below 1e-3", "worst", "no long double optimum"},
       .rows = {comparison_row("Table 2, B 0.02, pitch 0.3 mm", skin),
                comparison_row("random, valid ones", random)}});
  Figure figure{
      .title = "Error against conditioning",
      .x = {.label = "condition of the scaled covariance", .is_log = true},
      .y = {.label = "error / standard deviation", .is_log = true, .low = 1e-8},
      .series =
          {{.name = "random, double by samples", .color = kPalette[4], .points = random.in_double},
           {.name = "random, float vectors", .color = kPalette[1], .points = random.by_vectors},
           {.name = "skin, double by samples", .color = kPalette[2], .points = skin.in_double},
           {.name = "skin, float vectors", .color = kPalette[0], .points = skin.by_vectors}},
      .levels = {{1e-3, "asked for: 1e-3", {190, 30, 45}}}};
  bench.report.picture("stability", draw({figure}, 640, 460));
}

}  // namespace bench
