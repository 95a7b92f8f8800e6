// A vector of pixels' model: harmonics from the table, turned to where the pixels are, as the bins
// that samples are made of. Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_MODEL_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_MODEL_INL_H
#undef SSRIG_BATCH_MODEL_INL_H
#else
#define SSRIG_BATCH_MODEL_INL_H
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cstddef>
#include <numbers>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_nodes-inl.h"
#include "estimation/profile/batch_vectors-inl.h"
#include "estimation/profile/batch_waves-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// A sample as the model has it, and what the unknowns do to it.
struct Sample {
  V value, by_logit, by_log, by_phase;
};
constexpr std::size_t kModelFields = 4;  // of a sample

// What second derivatives along a step do to the gradient.
struct Bend {
  V by_logit, by_log, by_phase;
};

// The harmonics of a vector of pixels at one point of their search.
class Harmonics {
 public:
  // Nodes::set_tolerance.
  HWY_INLINE void set_tolerance(const BatchPlan& plan, const PixelBatch& batch, std::size_t first,
                                V tolerance, V truncation) {
    nodes_.set_tolerance(plan, batch, first, tolerance, truncation);
  }

  // False in lanes whose table lacks harmonics that matter. Lanes that are not wanted may hold
  // anything finite. `coarseness` multiplies the tolerance.
  HWY_INLINE M evaluate(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                        std::size_t first, V logit, V log, V position_px, V mean, M wanted,
                        float coarseness) {
    const M suffices = nodes_.load(plan, logit, log, wanted, coarseness);
    fill_bins(plan, basis, batch, first, position_px, mean, plan.harmonic_count);
    return suffices;
  }

  // The first harmonics alone, without factors, n = 1 at [0].
  template <std::size_t kCount>
  HWY_INLINE void get_first(const BatchPlan& plan, V logit, V log, V (&value)[kCount],
                            V (&by_logit)[kCount], V (&by_log)[kCount]) {
    static_assert(kCount % 4 == 0);
    nodes_.load_first(plan, logit, log, std::min(kCount / 4, plan.block_count));
    const V zero = hn::Zero(D());
    for (std::size_t n = 4 * plan.block_count; n < kCount; ++n)
      value[n] = by_logit[n] = by_log[n] = zero;
    for (std::size_t block = 0; block < std::min(kCount / 4, plan.block_count); ++block) {
      V a[4], t[4], l[4];
      nodes_.get(Nodes::kItself, block, a);
      nodes_.get(Nodes::kByLogit, block, t);
      nodes_.get(Nodes::kByLog, block, l);
      for (std::size_t i = 0; i < 4; ++i) {
        const std::size_t n = 4 * block + i;
        const bool is_there = n < static_cast<std::size_t>(plan.harmonic_count);
        value[n] = is_there ? a[i] : zero;
        by_logit[n] = is_there ? t[i] : zero;
        by_log[n] = is_there ? l[i] : zero;
      }
    }
  }

  // Calls add(j, sample) for each of the sweep's samples.
  template <bool kQuartered, typename Add>
  HWY_INLINE void for_samples(const SweepBasis& basis, const PixelBatch& batch, std::size_t first,
                              const Add& add) const {
    for_bins<kQuartered>(basis, batch, first, bins_,
                         [&](std::size_t j, const Fields<kModelFields>& of) HWY_ATTR {
                           add(j, Sample{of[0], of[1], of[2], of[3]});
                         });
  }

  // The same into [j].
  template <bool kQuartered>
  HWY_NOINLINE void get_samples(const SweepBasis& basis, const PixelBatch& batch, std::size_t first,
                                Sample* samples) const {
    for_samples<kQuartered>(basis, batch, first, [&](std::size_t j, const Sample& sample) HWY_ATTR {
      samples[j] = sample;
    });
  }

  // The samples' expected shift, 1/2 tr(H C) for second derivatives H at the point evaluated last
  // and the covariance set: of all samples of `basis`, which may be any of the sweep's.
  //   mean   what the mean shifts
  template <bool kQuartered>
  HWY_NOINLINE void get_shifts(const SweepBasis& basis, const PixelBatch& batch, std::size_t first,
                               V mean, V* shifts) {
    bent_bins_.count = std::min(bent_count_ + 1, basis.bin_stride);
    bent_bins_.parts[0][0] = mean;
    bent_bins_.parts[0][1] = hn::Zero(D());
    for (std::size_t n = 1; n <= bent_count_; ++n) add_to_bin<1>(basis, n, shifts_[n], bent_bins_);
    for_bins<kQuartered>(basis, batch, first, bent_bins_,
                         [&](std::size_t j, const Fields<1>& shift)
                             HWY_ATTR { shifts[j] = shift[0]; });
  }

  // (t, ln l, phase), for get_shifts.
  HWY_NOINLINE void set_covariance(V tt, V tl, V ll, V tp, V lp, V pp) {
    const D d;
    nodes_.load_curvature(tt, tl, ll);
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period_;
    const V half_pp = hn::Mul(pp, hn::Set(d, 0.5F * wave_per_px * wave_per_px));
    const V turn_t = hn::Mul(tp, hn::Set(d, wave_per_px)),
            turn_l = hn::Mul(lp, hn::Set(d, wave_per_px));
    bent_count_ = std::min(4 * nodes_.bent_block_count(), harmonic_count_);
    for (std::size_t block = 0; 4 * block < bent_count_; ++block) {
      const M is_bent = nodes_.is_bent(block);
      V a[4], by_logit[4], by_log[4], curvature[4];
      nodes_.get(Nodes::kItself, block, a);
      nodes_.get(Nodes::kByLogit, block, by_logit);
      nodes_.get(Nodes::kByLog, block, by_log);
      nodes_.get(Nodes::kCurvature, block, curvature);
      for (std::size_t i = 0; i < 4 && 4 * block + i < bent_count_; ++i) {
        const std::size_t n = 4 * block + i + 1;
        const V order = hn::Set(d, static_cast<float>(n));
        const Complex shift{
            hn::NegMulAdd(hn::Mul(hn::Mul(order, order), half_pp), a[i], curvature[i]),
            hn::Mul(order, hn::MulAdd(turn_t, by_logit[i], hn::Mul(turn_l, by_log[i])))};
        const Complex g = times(shift, turned_[n]);
        shifts_[n][0] = hn::IfThenElseZero(is_bent, g.re);
        shifts_[n][1] = hn::IfThenElseZero(is_bent, g.im);
      }
    }
  }

  // The model's second derivatives along a step, their product with residuals that have these first
  // harmonics.
  template <std::size_t kCount>
  HWY_NOINLINE Bend bend_along(const Bins<1>& residuals, V t, V l, V p) {
    static_assert(kCount % 4 == 0);
    const D d;
    const V zero = hn::Zero(d);
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period_;
    V along_t[kCount], along_l[kCount];
    nodes_.get_curvature_along(t, l, along_t, along_l);
    Bend bend{zero, zero, zero};
    for (std::size_t block = 0; 4 * block < std::min(kCount, harmonic_count_); ++block) {
      V a[4], by_logit[4], by_log[4];
      nodes_.get(Nodes::kItself, block, a);
      nodes_.get(Nodes::kByLogit, block, by_logit);
      nodes_.get(Nodes::kByLog, block, by_log);
      for (std::size_t i = 0; i < 4 && 4 * block + i < harmonic_count_; ++i) {
        const std::size_t n = 4 * block + i + 1;
        const Complex seen =
            times_conjugate(turned_[n], {residuals.parts[n][0], residuals.parts[n][1]});
        const V wave = hn::Set(d, static_cast<float>(n) * wave_per_px);
        const V slope = hn::Mul(wave, seen.im), moved = hn::Mul(slope, p);
        bend.by_logit = hn::MulAdd(along_t[n - 1], seen.re, bend.by_logit);
        bend.by_logit = hn::NegMulAdd(by_logit[i], moved, bend.by_logit);
        bend.by_log = hn::MulAdd(along_l[n - 1], seen.re, bend.by_log);
        bend.by_log = hn::NegMulAdd(by_log[i], moved, bend.by_log);
        const V shaped = hn::MulAdd(by_logit[i], t, hn::Mul(by_log[i], l));
        bend.by_phase = hn::NegMulAdd(slope, shaped, bend.by_phase);
        bend.by_phase =
            hn::NegMulAdd(hn::Mul(hn::Mul(wave, wave), seen.re), hn::Mul(a[i], p), bend.by_phase);
      }
    }
    return bend;
  }

  HWY_INLINE M has_at_most(std::size_t harmonic_count) const {
    return nodes_.has_at_most(harmonic_count / 4);
  }

  std::size_t blocks() const { return nodes_.block_count(); }

 private:
  HWY_NOINLINE void fill_bins(const BatchPlan& plan, const SweepBasis& basis,
                              const PixelBatch& batch, std::size_t first, V position_px, V mean,
                              int most_harmonics) {
    const D d;
    per_period_ = 1 / static_cast<float>(plan.shape.period_px);
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period_;
    const Complex turn = unit_at(hn::Mul(position_px, hn::Set(d, per_period_)));
    harmonic_count_ = std::min(4 * nodes_.block_count(), static_cast<std::size_t>(most_harmonics));
    bins_.count = std::min(harmonic_count_ + 1, basis.bin_stride);
    for (V& part : bins_.parts[0]) part = hn::Zero(d);
    bins_.parts[0][0] = mean;
    Complex unit = {hn::Add(turn.re, turn.re), hn::Add(turn.im, turn.im)};  // G = 2 a f
    const V first_wave = hn::Set(d, wave_per_px);
    V wave = hn::Zero(d);
    for (std::size_t block = 0; 4 * block < harmonic_count_; ++block) {
      V a[4], by_logit[4], by_log[4];
      nodes_.get(Nodes::kItself, block, a);
      nodes_.get(Nodes::kByLogit, block, by_logit);
      nodes_.get(Nodes::kByLog, block, by_log);
      for (std::size_t i = 0; i < 4 && 4 * block + i < harmonic_count_; ++i) {
        const std::size_t n = 4 * block + i + 1;
        const Complex g = batch.factor_re.empty() ? unit : times(unit, factor_of(batch, n, first));
        wave = hn::Add(wave, first_wave);
        const V turned = hn::Mul(a[i], wave);
        const V parts[2 * kModelFields] = {hn::Mul(a[i], g.re),
                                           hn::Mul(a[i], g.im),
                                           hn::Mul(by_logit[i], g.re),
                                           hn::Mul(by_logit[i], g.im),
                                           hn::Mul(by_log[i], g.re),
                                           hn::Mul(by_log[i], g.im),
                                           hn::Neg(hn::Mul(turned, g.im)),
                                           hn::Mul(turned, g.re)};
        add_to_bin<kModelFields>(basis, n, parts, bins_);
        turned_[n] = g;
        unit = times(unit, turn);
      }
    }
  }

  // Harmonics come in rising order: the first of a bin sets it, those folded into it add.
  template <std::size_t kFields>
  static HWY_INLINE void add_to_bin(const SweepBasis& basis, std::size_t n,
                                    const V (&parts)[2 * kFields], Bins<kFields>& bins) {
    if (n < basis.bin_stride) {
      for (std::size_t part = 0; part < 2 * kFields; ++part) bins.parts[n][part] = parts[part];
      return;
    }
    V* const bin = bins.parts[basis.bin_of[n]];
    for (std::size_t part = 0; part < 2 * kFields; part += 2) {
      bin[part] = hn::Add(bin[part], parts[part]);
      bin[part + 1] = basis.is_mirrored[n] ? hn::Sub(bin[part + 1], parts[part + 1])
                                           : hn::Add(bin[part + 1], parts[part + 1]);
    }
  }

  template <bool kQuartered, std::size_t kFields, typename Add>
  HWY_INLINE void for_bins(const SweepBasis& basis, const PixelBatch& batch, std::size_t first,
                           const Bins<kFields>& bins, const Add& add) const {
    if constexpr (kQuartered)
      for_quartered<kFields>(basis, bins, add);
    else if (batch.offset_px.size() > basis.sample_count)
      for_own_offsets<kFields>(basis, bins, batch, first, per_period_, add);
    else
      for_shared_shifts<kFields>(basis, bins, add);
  }

  Nodes nodes_;
  Complex turned_[kMostBatchHarmonics + 1];  // 2 f_n and the pixel's phase
  V shifts_[kMostBatchHarmonics + 1][2];     // 1/2 tr(H C)
  Bins<kModelFields> bins_;
  Bins<1> bent_bins_;
  std::size_t harmonic_count_ = 0, bent_count_ = 0;  // loaded; of those that bend
  float per_period_ = 0;
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
