#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/likelihood.h"
#include "estimation/profile/start_grid.h"
#include "estimation/profile/sweep_basis.h"

namespace estimation {
namespace {

constexpr std::size_t kWidestVector = 16;

void store(const PixelFit& pixel, std::size_t i, BatchFit& fit) {
  fit.logit_reflectance[i] = static_cast<float>(pixel.logit_reflectance);
  fit.log_translucency_px[i] = static_cast<float>(pixel.log_translucency_px);
  fit.indirect[i] = static_cast<float>(pixel.indirect);
  fit.phase_px[i] = static_cast<float>(pixel.phase_px);
  for (std::size_t k = 0; k < pixel.covariance.size(); ++k)
    fit.covariance[k * fit.stride + i] = static_cast<float>(pixel.covariance[k]);
  fit.reduced_chi_square[i] = pixel.degrees_of_freedom > 0
                                  ? static_cast<float>(pixel.chi_square / pixel.degrees_of_freedom)
                                  : 1.0F;
  fit.validity[i] = pixel.validity;
}

// What the vectors cannot do is left to fit_pixel: no table, more than they hold, or only some of
// the harmonics that the samples hold.
bool is_for_vectors(const FitProblem& problem) {
  if (problem.table == nullptr || problem.table->rows() == 0) return false;
  const auto samples = static_cast<int>(problem.shifts_px.size());
  const int harmonic_count = problem.table->harmonic_count();
  return (problem.harmonic_count == 0 || 2 * problem.harmonic_count + 1 >= samples) &&
         harmonic_count >= 2 && harmonic_count <= static_cast<int>(kMostBatchHarmonics) &&
         samples >= 5 && samples <= static_cast<int>(kMostBatchSamples) && !problem.noise.empty() &&
         problem.noise.size() <= BatchPlan::kMostNoise;
}

// BatchPlan::sizes.
std::vector<float> sizes_of(const HarmonicTable& table, std::size_t block_count) {
  std::vector<float> sizes;
  sizes.reserve(static_cast<std::size_t>(table.rows()) * static_cast<std::size_t>(table.cols()) *
                block_count);
  const auto count = static_cast<std::size_t>(table.harmonic_count());
  for (int row = 0; row < table.rows(); ++row)
    for (int col = 0; col < table.cols(); ++col) {
      const std::span<const float> node = table.node(row, col);
      const std::size_t first = sizes.size();
      sizes.resize(first + block_count);
      float size = 0;
      for (std::size_t block = block_count; block-- > 0;) {
        for (std::size_t n = 4 * block; n < std::min(4 * block + 4, count); ++n)
          for (std::size_t term = 0; term < 3; ++term)
            size = std::max(size, std::abs(node[term * table.harmonic_stride() + n]));
        sizes[first + block] = size;
      }
    }
  return sizes;
}

// variance_at's entries.
BatchPlan::Noise in_floats(const MergedNoise& noise) {
  const double variance = noise.read_variance + noise.shot_dn_per_us * noise.up_to_dn_per_us;
  // A jump is a steep ramp; the last entry has no end.
  const double width = std::max(kMixtureWidth * std::sqrt(variance), 1e-6 * noise.up_to_dn_per_us);
  const bool is_last = !std::isfinite(noise.up_to_dn_per_us);
  return {.read_variance = static_cast<float>(noise.read_variance),
          .shot_dn_per_us = static_cast<float>(noise.shot_dn_per_us),
          .per_width = is_last ? 0.0F : static_cast<float>(1 / width),
          .middle = is_last ? 0.0F : static_cast<float>(noise.up_to_dn_per_us / width - 0.5)};
}

}  // namespace

void BatchFit::resize(std::size_t stride_wanted) {
  stride = stride_wanted;
  for (std::vector<float>* row :
       {&logit_reflectance, &log_translucency_px, &indirect, &phase_px, &reduced_chi_square})
    row->resize(stride);
  covariance.resize(stride * kUnknowns * (kUnknowns + 1) / 2);
  validity.resize(stride);
}

class BatchFitter::Prepared {
 public:
  explicit Prepared(const FitProblem& problem) : problem_(problem) {
    if (!is_for_vectors(problem)) return;
    const int harmonic_count = problem.table->harmonic_count();
    basis_.emplace();
    make_sweep_basis(problem, {}, harmonic_count, Symmetry::kUsed, *basis_);
    if (!basis_->can_start || basis_->second > harmonic_count) {
      basis_.reset();
      return;
    }
    if (basis_->is_quartered && basis_->sample_count >= kFewestOfFirst) {
      first_.emplace();
      make_even_basis(kFirstSamples, static_cast<int>(kFirstHarmonics), *first_);
      if (basis_->sample_count % 8 == 0) {
        half_.emplace();
        make_even_basis(basis_->sample_count / 2, harmonic_count, *half_);
      }
    }
    start_.emplace(*problem.table, problem.indirect, basis_->second);
    plan_.table = problem.table;
    plan_.block_count = static_cast<std::size_t>(harmonic_count + 3) / 4;
    sizes_ = sizes_of(*problem.table, plan_.block_count);
    plan_.sizes = sizes_.data();
    plan_.start = &*start_;
    plan_.first = first_ ? &*first_ : nullptr;
    plan_.half = half_ ? &*half_ : nullptr;
    plan_.shape = problem.shape;
    plan_.projector_black_frac = static_cast<float>(problem.projector_black_frac);
    plan_.is_free = problem.indirect == IndirectLight::kFree;
    plan_.harmonic_count = harmonic_count;
    for (const MergedNoise& noise : problem.noise)
      plan_.noise[plan_.noise_count++] = in_floats(noise);
  }

  void fit(const PixelBatch& batch, BatchFit& fit) const {
    const std::size_t padded = (batch.count + kWidestVector - 1) / kWidestVector * kWidestVector;
    if (fit.stride < padded) fit.resize(std::max(padded, batch.stride));
    if (!basis_) {
      std::fill_n(fit.validity.begin(), batch.count, kLeftToFitPixel);
    } else if (batch.offset_px.empty()) {
      fit_vectors(plan_, *basis_, batch, fit);
    } else {
      SweepBasis shifted;
      const bool is_shared = batch.offset_px.size() == problem_.shifts_px.size();
      make_sweep_basis(problem_, is_shared ? batch.offset_px : std::span<const float>{},
                       plan_.harmonic_count, Symmetry::kIgnored, shifted);
      fit_vectors(plan_, shifted, batch, fit);
    }
    for (std::size_t i = 0; i < batch.count; ++i)
      if (fit.validity[i] == kLeftToFitPixel) store(fit_pixel(problem_, batch, i), i, fit);
  }

 private:
  FitProblem problem_;
  std::optional<SweepBasis> basis_;         // of the nominal shifts; none: all is left to fit_pixel
  std::optional<SweepBasis> first_, half_;  // BatchPlan
  std::optional<StartGrid> start_;
  std::vector<float> sizes_;
  BatchPlan plan_;
};

BatchFitter::BatchFitter(const FitProblem& problem)
    : prepared_(std::make_unique<const Prepared>(problem)) {}
BatchFitter::BatchFitter(BatchFitter&&) noexcept = default;
BatchFitter& BatchFitter::operator=(BatchFitter&&) noexcept = default;
BatchFitter::~BatchFitter() = default;

void BatchFitter::fit(const PixelBatch& batch, BatchFit& fit) const { prepared_->fit(batch, fit); }

void fit_batch(const FitProblem& problem, const PixelBatch& batch, BatchFit& fit) {
  BatchFitter(problem).fit(batch, fit);
}

}  // namespace estimation
