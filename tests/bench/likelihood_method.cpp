// Our fit as one of the competing methods.
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "estimation/session/maps.h"
#include "tests/bench/methods.h"

namespace bench {
namespace {

using estimation::BatchFit;
using estimation::covariance_index;
using estimation::FitProblem;
using estimation::HarmonicTable;

constexpr std::size_t kBlock = 1024;  // pixels: their samples stay in cache
constexpr int kHarmonics = 40;        // of a table: beyond them skin keeps 1e-7

double reflectance_of(double logit) { return 1 / (1 + std::exp(-logit)); }
double logit_of(double reflectance) { return std::log(reflectance / (1 - reflectance)); }

Estimate estimate_of(double logit, double log_translucency_px, double indirect,
                     double logit_variance, double log_variance, double reduced_chi_square,
                     std::uint32_t validity) {
  const double reflectance = reflectance_of(logit);
  return {.diffuse_reflectance = reflectance,
          .translucency_px = std::exp(log_translucency_px),
          .indirect = indirect,
          .log_reflectance_sd = (1 - reflectance) * std::sqrt(logit_variance),
          .log_translucency_sd = std::sqrt(log_variance),
          .reduced_chi_square = reduced_chi_square,
          .is_valid = (validity & estimation::kValidityErrors) == 0};
}

class LikelihoodMethod : public Method {
 public:
  LikelihoodMethod(std::string name, const estimation::ScatteringModel& model,
                   const HarmonicTable& table, const LikelihoodOptions& options)
      : name_(std::move(name)), model_(model), table_(table), options_(options) {}
  std::string name() const override { return name_; }

  void prepare(const PixelSet& pixels) override {
    problem_ = {.shape = pixels.shape,
                .shifts_px = pixels.shifts_px,
                .noise = pixels.noise,
                .projector_black_frac = 0,
                .model = &model_,
                .table = &table_,
                .harmonic_count = options_.harmonic_count,
                .indirect = options_.indirect};
    fitter_.emplace(problem_);
  }

  void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const override {
    estimates.resize(pixels.count);
    tbb::enumerable_thread_specific<BatchFit> fits;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, (pixels.count + kBlock - 1) / kBlock, 1),
                      [&](const auto& blocks) {
                        for (std::size_t block = blocks.begin(); block < blocks.end(); ++block)
                          run_block(pixels, block * kBlock, fits.local(), estimates);
                      });
  }

 private:
  void run_block(const PixelSet& pixels, std::size_t first, BatchFit& fit,
                 std::vector<Estimate>& estimates) const {
    const std::size_t count = std::min(kBlock, pixels.count - first);
    const estimation::PixelBatch batch = pixels.batch(first, count);
    const auto place = [&](std::size_t i) {
      return static_cast<double>(pixels.position_px[first + i]);
    };
    if (options_.is_double) {
      for (std::size_t i = 0; i < count; ++i) {
        const estimation::PixelFit found = fit_pixel(problem_, batch, i);
        estimates[first + i] = estimate_of(
            found.logit_reflectance, found.log_translucency_px, found.indirect,
            found.covariance[covariance_index(0, 0)], found.covariance[covariance_index(1, 1)],
            found.chi_square / std::max(found.degrees_of_freedom, 1), found.validity);
        estimates[first + i].u_px = place(i) + found.phase_px;
      }
      return;
    }
    fitter_->fit(batch, fit);
    const auto at = [&](const std::vector<float>& row, std::size_t i) {
      return static_cast<double>(row[i]);
    };
    for (std::size_t i = 0; i < count; ++i) {
      estimates[first + i] = estimate_of(
          at(fit.logit_reflectance, i), at(fit.log_translucency_px, i), at(fit.indirect, i),
          at(fit.covariance, covariance_index(0, 0) * fit.stride + i),
          at(fit.covariance, covariance_index(1, 1) * fit.stride + i),
          at(fit.reduced_chi_square, i), fit.validity[i]);
      estimates[first + i].u_px = place(i) + at(fit.phase_px, i);
    }
  }

  std::string name_;
  const estimation::ScatteringModel& model_;
  const HarmonicTable& table_;
  LikelihoodOptions options_;
  FitProblem problem_;
  std::optional<estimation::BatchFitter> fitter_;
};

}  // namespace

std::unique_ptr<Method> likelihood(const std::string& name,
                                   const estimation::ScatteringModel& model,
                                   const HarmonicTable& table, const LikelihoodOptions& options) {
  return std::make_unique<LikelihoodMethod>(name, model, table, options);
}

HarmonicTable harmonic_table(const estimation::ScatteringModel& model, const PixelSet& for_pixels) {
  double low = 1, high = 0, least_px = 1e9, greatest_px = 0;
  for (const Subject& subject : for_pixels.subjects) {
    const double l_d_px = subject.translucency_mm / subject.pitch_mm;
    low = std::min(low, subject.diffuse_reflectance);
    high = std::max(high, subject.diffuse_reflectance);
    least_px = std::min(least_px, l_d_px);
    greatest_px = std::max(greatest_px, l_d_px);
  }
  const estimation::ShapeRange range{.least = {logit_of(low) - 1, std::log(least_px) - 0.7},
                                     .greatest = {logit_of(high) + 1, std::log(greatest_px) + 0.7}};
  return {model, for_pixels.shape, range, kHarmonics};
}

HarmonicTable wide_harmonic_table(const estimation::ScatteringModel& model,
                                  estimation::StripeShape shape) {
  return {model, shape, {}, kHarmonics};
}

}  // namespace bench
