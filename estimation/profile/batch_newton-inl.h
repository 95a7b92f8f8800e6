// What a Gauss-Newton step leaves: along it weights and derivatives change, and residuals that they
// multiply do not vanish. One more solution with what that does to the gradient takes the place of
// a second step on all samples. Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_NEWTON_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_NEWTON_INL_H
#undef SSRIG_BATCH_NEWTON_INL_H
#else
#define SSRIG_BATCH_NEWTON_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_normal-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"
#include "estimation/profile/batch_waves-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// Harmonics of the weighted residuals that meet the model's second derivatives.
constexpr std::size_t kBendingHarmonics = 8;

// What changed weights do to the gradient where the step x has been taken.
//   mean_step  what the step does to the mean
//   rest       [j] the residuals that remain, times their weight there
template <typename Noise>
HWY_NOINLINE ShiftSums changed_weights(const Noise& given, const V* measured, std::size_t count,
                                       const Samples& samples, const Solution& x, V mean_step,
                                       V* rest) {
  const Noise noise = given;
  const V zero = hn::Zero(D());
  ShiftSums s{zero, zero, zero, zero};
  for (std::size_t j = 0; j < count; ++j) {
    const Sample& model = samples.at[j];
    V change = hn::MulAdd(model.by_logit, x.t, mean_step);
    change = hn::MulAdd(model.by_phase, x.p, hn::MulAdd(model.by_log, x.l, change));
    const V value = hn::Add(model.value, change), residual = hn::Sub(measured[j], value);
    const V weighted = hn::Mul(reciprocal(noise.variance(value)), residual);
    const V more = hn::NegMulAdd(samples.weight[j], residual, weighted);
    s.e = hn::Add(s.e, more);
    s.et = hn::MulAdd(more, model.by_logit, s.et);
    s.el = hn::MulAdd(more, model.by_log, s.el);
    s.ep = hn::MulAdd(more, model.by_phase, s.ep);
    rest[j] = weighted;
  }
  return s;
}

// What changed derivatives do to the gradient, added to `s`.
HWY_NOINLINE void add_changed_derivatives(const SweepBasis& basis, const V* rest, const Solution& x,
                                          Harmonics& harmonics, ShiftSums& s) {
  Bins<1> bins;
  harmonics_of<kBendingHarmonics>(basis, rest, bins);
  const V half_count = hn::Set(D(), 0.5F * static_cast<float>(basis.sample_count));
  const Bend bend = harmonics.bend_along<kBendingHarmonics>(bins, x.t, x.l, x.p);
  s.et = hn::MulAdd(half_count, bend.by_logit, s.et);
  s.el = hn::MulAdd(half_count, bend.by_log, s.el);
  s.ep = hn::MulAdd(half_count, bend.by_phase, s.ep);
}

// What is to be added to a step.
struct Correction {
  V t, l, p, mean;
};

HWY_INLINE void correct(M where, const Correction& by, Solution& x) {
  const auto add = [&](V& to, V value)
                       HWY_ATTR { to = hn::Add(to, hn::IfThenElseZero(where, value)); };
  add(x.t, by.t);
  add(x.l, by.l);
  add(x.p, by.p);
  add(x.mean, by.mean);
}

// What the step x leaves.
//   bends  lanes whose step is so long that derivatives change
HWY_INLINE Correction correction_of(const BatchPlan& plan, const SweepBasis& basis,
                                    const Pixels& pixels, const Samples& samples, const Sums& sums,
                                    const Solution& x, V mean_slope, M bends,
                                    Harmonics& harmonics) {
  const D d;
  V rest[kMostBatchSamples];
  const V mean_step = plan.is_free ? x.mean : hn::Mul(mean_slope, x.t);
  ShiftSums change = pixels.noise.count == 2
                         ? changed_weights(NoiseOfTwo(pixels.noise), pixels.measured,
                                           basis.sample_count, samples, x, mean_step, rest)
                         : changed_weights(pixels.noise, pixels.measured, basis.sample_count,
                                           samples, x, mean_step, rest);
  if (!hn::AllFalse(d, bends)) {
    ShiftSums bent = change;
    add_changed_derivatives(basis, rest, x, harmonics, bent);
    const auto take = [&](V& sum, V value) HWY_ATTR { sum = hn::IfThenElse(bends, value, sum); };
    take(change.et, bent.et);
    take(change.el, bent.el);
    take(change.ep, bent.ep);
  }
  Sums changed = sums;
  changed.e = change.e;
  changed.et = change.et;
  changed.el = change.el;
  changed.ep = change.ep;
  const Solution more = solve(plan, changed, mean_slope);
  return {more.t, more.l, more.p, more.mean};
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
