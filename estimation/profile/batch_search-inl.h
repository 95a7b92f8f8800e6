// Gauss-Newton on the samples of a vector of pixels, and the correction of where it ends.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_SEARCH_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_SEARCH_INL_H
#undef SSRIG_BATCH_SEARCH_INL_H
#else
#define SSRIG_BATCH_SEARCH_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "estimation/profile/batch_first-inl.h"
#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_newton-inl.h"
#include "estimation/profile/batch_normal-inl.h"
#include "estimation/profile/batch_outcome-inl.h"
#include "estimation/profile/batch_rescue-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// Harmonics of this share of a sample's noise are left out: they move a pixel's estimates by less
// than 1e-3 standard deviations. Where shifts are few or uneven they pass for lower ones.
constexpr float kToleranceOfNoise = 0.015F, kToleranceIfAliased = 0.01F;
constexpr std::size_t kFewestUnaliased = 32;
// A table that lacks larger ones is too short.
constexpr float kTruncation = 0.05F;
// A first step on all samples may be rough: it leaves so many times as much out.
constexpr float kRough = 40;
// A search ends when what would remain of it, judged by how much shorter this step is than the one
// before, is below a thousandth of a standard deviation. Squared, as are the steps' lengths; the
// step before the first counts as one standard deviation, a first step on few samples as that at
// least.
constexpr float kGreatestRest = 1e-6F, kFirstLength = 1, kSlowestEnd = 0.25F;
// After a first step on few samples a step's length tells how good that was, not how fast the
// search is. What a step leaves grows with its length and with how far the shape may be off: with
// their product (squared; lengths in standard deviations, the shape in t and ln l). Beyond the
// first of these changed derivatives count, beyond the others a step has to follow.
constexpr float kLeastBending = 1.5e-6F, kGreatestProduct = 2e-5F, kLongestLast = 1;
constexpr float kLengthAfterCorrection = 1e-4F;
constexpr float kGreatestLogitStep = 1, kGreatestLogStep = 0.75F;
constexpr int kMostSteps = 12;
// Of a correction for bias, as in likelihood_pixel.cpp.
constexpr float kGreatestCorrection = 0.5F;
// Harmonics up to this many quarters of the samples of half a sweep do not make it take one for
// another where products of two are added up.
constexpr std::size_t kMostOfHalf = 5;

// Where the search has come to. Lanes that have ended stay where they are, so that in the end all
// are at their last point.
struct Progress {
  State state;      // evaluated last
  V length_before;  // squared, of the step before
  M active, ended;
  M has_begun;  // lanes with a step behind them
};

// The step shortened to what a quadratic model may be believed over.
HWY_INLINE State stepped(const BatchPlan& plan, const State& from, const Solution& x) {
  const D d;
  V longest = hn::Max(hn::Set(d, 1.0F), hn::Mul(hn::Abs(x.t), hn::Set(d, 1 / kGreatestLogitStep)));
  longest = hn::Max(longest, hn::Mul(hn::Abs(x.l), hn::Set(d, 1 / kGreatestLogStep)));
  longest = hn::Max(
      longest, hn::Mul(hn::Abs(x.p), hn::Set(d, 8 / static_cast<float>(plan.shape.period_px))));
  const V share = hn::Div(hn::Set(d, 1.0F), longest);
  return {hn::MulAdd(x.t, share, from.logit), hn::MulAdd(x.l, share, from.log),
          hn::MulAdd(x.mean, share, from.mean), hn::MulAdd(x.p, share, from.phase_px)};
}

// In the table's range.
HWY_INLINE State held(const BatchPlan& plan, State state) {
  const D d;
  const auto& [least, greatest] = plan.table->range();
  const auto within = [&](V value, double low, double high) HWY_ATTR {
    return hn::Min(hn::Max(value, hn::Set(d, static_cast<float>(low))),
                   hn::Set(d, static_cast<float>(high)));
  };
  state.logit = within(state.logit, least.logit_reflectance, greatest.logit_reflectance);
  state.log = within(state.log, least.log_translucency_px, greatest.log_translucency_px);
  return state;
}

HWY_INLINE State chosen(M mask, const State& yes, const State& no) {
  return {hn::IfThenElse(mask, yes.logit, no.logit), hn::IfThenElse(mask, yes.log, no.log),
          hn::IfThenElse(mask, yes.mean, no.mean), hn::IfThenElse(mask, yes.phase_px, no.phase_px)};
}

// One step on the first harmonics of the data, as fewer samples: of a pixel whose sweep is complete
// it leaves some hundredths of a standard deviation, for lack of the other harmonics; a second one
// would leave as much.
HWY_NOINLINE void first_step(const BatchPlan& plan, const PixelBatch& batch, std::size_t first,
                             const Pixels& pixels, const Bins<1>& data, Harmonics& harmonics,
                             Progress& progress) {
  const D d;
  FoldedSweep sweep;
  sweep.load(batch, first, data);
  State& state = progress.state;
  const Reflectance reflectance = reflectance_at(state.logit);
  if (!plan.is_free) state.mean = hn::Mul(pixels.level, reflectance.value);
  const Sums sums = sweep.at(plan, pixels, state, harmonics);
  const Solution x = solve(plan, sums, hn::Mul(pixels.level, reflectance.slope));
  progress.has_begun = hn::And(pixels.is_complete, x.is_definite);
  state = chosen(progress.has_begun, held(plan, stepped(plan, state, x)), state);
  // Each of these samples is worth more than one; the sums are over half of them.
  const V per_sample = hn::Mul(pixels.present, hn::Set(d, 2.0F / kFirstSamples));
  progress.length_before = hn::Max(hn::Mul(x.length, per_sample), hn::Set(d, kFirstLength));
  progress.length_before =
      hn::IfThenElse(progress.has_begun, progress.length_before, hn::Set(d, kFirstLength));
}

// Takes off what curvature adds on average, as Fit::unbiased in likelihood_pixel.cpp does it: one
// more step with the samples' expected shift as their residual. And what it added to the last step:
// the shift that this step makes is no residual.
//   samples    at the point evaluated last, `at`
//   x          the step from there to `next`, where the search ended
//   needs_all  lanes for which half of the sweep is not enough
template <bool kQuartered>
HWY_NOINLINE State unbiased(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                            std::size_t first, const Pixels& pixels, const Samples& samples,
                            const Sums& sums, const Solution& x, const State& at, const State& next,
                            M where, M needs_all, Harmonics& harmonics) {
  const D d;
  const Reflectance reflectance = reflectance_at(at.logit);
  const V slope = hn::Mul(pixels.level, reflectance.slope);
  const V half = hn::Set(d, 0.5F);
  const V rate = hn::Sub(half, reflectance.value);  // half of R_d'' / R_d'
  const auto left = [&](V covariance, V a, V b) HWY_ATTR {
    return hn::IfThenElseZero(where, hn::NegMulAdd(a, b, covariance));
  };
  const V tt = left(x.tt, x.t, x.t);
  harmonics.set_covariance(tt, left(x.tl, x.t, x.l), left(x.ll, x.l, x.l), left(x.tp, x.t, x.p),
                           left(x.lp, x.l, x.p), left(x.pp, x.p, x.p));
  const V mean = plan.is_free ? hn::Zero(d) : hn::Mul(slope, hn::Mul(rate, tt));
  V shifts[kMostBatchSamples];
  Sums shifted = sums;
  const auto take = [&](M lanes, const ShiftSums& from, V scale) HWY_ATTR {
    shifted.e = hn::IfThenElse(lanes, hn::Mul(scale, from.e), shifted.e);
    shifted.et = hn::IfThenElse(lanes, hn::Mul(scale, from.et), shifted.et);
    shifted.el = hn::IfThenElse(lanes, hn::Mul(scale, from.el), shifted.el);
    shifted.ep = hn::IfThenElse(lanes, hn::Mul(scale, from.ep), shifted.ep);
  };
  if (!hn::AllFalse(d, hn::And(where, needs_all))) {
    harmonics.template get_shifts<kQuartered>(basis, batch, first, mean, shifts);
    take(needs_all, sums_of(samples, shifts, basis.sample_count, 1), hn::Set(d, 1.0F));
  }
  if constexpr (kQuartered)
    if (!hn::AllFalse(d, hn::AndNot(needs_all, where))) {
      harmonics.get_shifts<true>(*plan.half, batch, first, mean, shifts);
      take(hn::Not(needs_all), sums_of(samples, shifts, plan.half->sample_count, 2),
           hn::Set(d, 2.0F));
    }
  const Solution step = solve(plan, shifted, slope);
  const V t = hn::NegMulAdd(rate, hn::IfThenElseZero(where, x.tt), step.t),
          l = hn::NegMulAdd(half, x.ll, step.l);
  const V length = squared_length(sums, t, l, plan.is_free ? step.mean : hn::Mul(slope, t), step.p);
  const V greatest = hn::Set(d, kGreatestCorrection);
  const V share = hn::Div(greatest, hn::Max(hn::Sqrt(hn::Max(length, hn::Zero(d))), greatest));
  return {hn::MulAdd(share, t, next.logit), hn::MulAdd(share, l, next.log),
          hn::MulAdd(share, step.mean, next.mean), hn::MulAdd(share, step.p, next.phase_px)};
}

// Lanes for which half of the sweep is not enough to take off the bias.
HWY_INLINE M lanes_that_need_all(const BatchPlan& plan, const SweepBasis& basis,
                                 const Pixels& pixels, const Harmonics& harmonics) {
  if (!basis.is_quartered || plan.half == nullptr) return hn::Eq(pixels.present, pixels.present);
  const std::size_t most = plan.half->sample_count * kMostOfHalf / 4;
  return hn::Not(hn::And(pixels.is_complete, harmonics.has_at_most(most)));
}

//   data  of which a first step is taken, or none
template <bool kQuartered, bool kHasLost>
HWY_NOINLINE void search(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                         std::size_t first, const Pixels& pixels, const Bins<1>* data,
                         const State& from, M wanted, Harmonics& harmonics, Outcome& out) {
  const D d;
  const V zero = hn::Zero(d);
  const M none = hn::Lt(zero, zero);
  Samples samples;
  Progress progress{from, hn::Set(d, kFirstLength), wanted, none, none};
  const bool is_rough = !(kQuartered && data != nullptr);
  if (!is_rough) first_step(plan, batch, first, pixels, *data, harmonics, progress);
  const bool is_aliased = !basis.is_quartered || basis.sample_count < kFewestUnaliased;
  harmonics.set_tolerance(
      plan, batch, first,
      hn::Mul(pixels.noise_sd, hn::Set(d, is_aliased ? kToleranceIfAliased : kToleranceOfNoise)),
      hn::Mul(pixels.noise_sd, hn::Set(d, kTruncation)));
  State& state = progress.state;
  State next = from;
  M needs_all = none, corrected = none;
  Correction correction{zero, zero, zero, zero};
  Sums sums;
  Solution x;
  for (int count = 0; count < kMostSteps && !hn::AllFalse(d, progress.active); ++count) {
    const Reflectance reflectance = reflectance_at(state.logit);
    if (!plan.is_free) state.mean = hn::Mul(pixels.level, reflectance.value);
    const M suffices = harmonics.evaluate(plan, basis, batch, first, state.logit, state.log,
                                          hn::Add(pixels.position_px, state.phase_px), state.mean,
                                          hn::Or(progress.active, progress.ended),
                                          count == 0 && is_rough ? kRough : 1.0F);
    progress.active = hn::And(progress.active, suffices);
    needs_all = lanes_that_need_all(plan, basis, pixels, harmonics);
    harmonics.template get_samples<kQuartered>(basis, batch, first, samples.at);
    add_samples<kHasLost>(pixels.noise, pixels.measured, basis.sample_count, samples, sums);
    x = solve(plan, sums, hn::Mul(pixels.level, reflectance.slope));
    progress.active = hn::And(progress.active, x.is_definite);
    // Plain steps get nowhere with these.
    if (count >= kPatience)
      progress.active = hn::And(progress.active, hn::Lt(x.ll, hn::Set(d, kHopelessLogVariance)));
    const bool is_after_first = count == 0 && !is_rough;
    const V product = hn::Mul(x.length, hn::Add(x.tt, x.ll));
    if constexpr (kQuartered)
      if (is_after_first) {
        corrected = hn::And(progress.active, progress.has_begun);
        const M bends = hn::And(corrected, hn::Gt(product, hn::Set(d, kLeastBending)));
        correction = correction_of(plan, basis, pixels, samples, sums, x,
                                   hn::Mul(pixels.level, reflectance.slope), bends, harmonics);
      }
    correct(corrected, correction, x);
    next = stepped(plan, state, x);
    const M is_near = is_after_first
                          ? hn::And(hn::Lt(x.length, hn::Set(d, kLongestLast)),
                                    hn::Lt(product, hn::Set(d, kGreatestProduct)))
                          : hn::Lt(hn::Mul(x.length, x.length),
                                   hn::Mul(hn::Set(d, kGreatestRest), progress.length_before));
    const M is_fast = hn::Lt(x.length, hn::Mul(hn::Set(d, kSlowestEnd), progress.length_before));
    const M is_last =
        hn::And(hn::And(progress.active, progress.has_begun), hn::And(is_near, is_fast));
    progress.has_begun = hn::Not(none);
    // A corrected step has left less than its length tells.
    progress.length_before =
        is_after_first ? hn::Min(x.length, hn::Set(d, kLengthAfterCorrection)) : x.length;
    const State inside = held(plan, next);
    const M is_inside = hn::And(hn::Eq(inside.logit, next.logit), hn::Eq(inside.log, next.log));
    progress.ended = hn::Or(progress.ended, hn::And(is_last, is_inside));
    corrected = hn::And(corrected, progress.ended);  // which take the same step again
    // At the border of the table twice in a row: the exact model goes on.
    const M is_stuck = hn::And(hn::Eq(inside.logit, state.logit), hn::Eq(inside.log, state.log));
    progress.active = hn::AndNot(hn::Or(is_last, hn::AndNot(is_inside, is_stuck)), progress.active);
    state = chosen(progress.active, inside, state);
  }
  if (hn::AllFalse(d, progress.ended)) return;
  const State best = unbiased<kQuartered>(plan, basis, batch, first, pixels, samples, sums, x,
                                          state, next, progress.ended, needs_all, harmonics);
  finish(plan, pixels, sums, x, reflectance_at(next.logit).slope, best, progress.ended, out);
}

// Not inlined: scenes hardly need it.
template <bool kQuartered>
HWY_NOINLINE void search_again(const BatchPlan& plan, const SweepBasis& basis,
                               const PixelBatch& batch, std::size_t first, const Pixels& pixels,
                               const State& from, M active, Harmonics& harmonics, Outcome& out) {
  const Rescue found =
      rescue<kQuartered>(plan, basis, batch, first, pixels, from, active, harmonics);
  out.is_hidden = hn::Or(out.is_hidden, found.is_hopeless);
  search<kQuartered, true>(plan, basis, batch, first, pixels, nullptr, found.state, found.is_near,
                           harmonics, out);
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
