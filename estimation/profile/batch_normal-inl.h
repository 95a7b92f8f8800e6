// The normal equations of a vector of pixels: sums over samples, and their solution.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_NORMAL_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_NORMAL_INL_H
#undef SSRIG_BATCH_NORMAL_INL_H
#else
#define SSRIG_BATCH_NORMAL_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// Of a pivot over its diagonal: below, single precision has lost its digits.
constexpr float kLeastPivot = 1e-5F;

// Sums over the samples of the normal equations in (t, ln l, phase, mean level).
struct Sums {
  V w, t, l, p, tt, tl, tp, ll, lp, pp, e, et, el, ep, ee;
};

HWY_INLINE void clear(Sums& s) {
  const V zero = hn::Zero(D());
  s = {zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero};
}

// Those of `from` where `where`.
HWY_INLINE void take_sums(M where, const Sums& from, Sums& to) {
  const auto take = [&](V& sum, V value) HWY_ATTR { sum = hn::IfThenElse(where, value, sum); };
  take(to.w, from.w);
  take(to.t, from.t);
  take(to.l, from.l);
  take(to.p, from.p);
  take(to.tt, from.tt);
  take(to.tl, from.tl);
  take(to.tp, from.tp);
  take(to.ll, from.ll);
  take(to.lp, from.lp);
  take(to.pp, from.pp);
  take(to.e, from.e);
  take(to.et, from.et);
  take(to.el, from.el);
  take(to.ep, from.ep);
  take(to.ee, from.ee);
}

// With a diagonal larger by this share.
HWY_INLINE Sums damped(Sums sums, V damping) {
  sums.tt = hn::MulAdd(damping, sums.tt, sums.tt);
  sums.ll = hn::MulAdd(damping, sums.ll, sums.ll);
  sums.pp = hn::MulAdd(damping, sums.pp, sums.pp);
  return sums;
}

// All samples of a sweep: as the model has them, and, once they are added up, what they weigh.
struct Samples {
  Sample at[kMostBatchSamples];  // [j]
  V weight[kMostBatchSamples];
};

// One sample: the model's value there with its derivatives, and what was measured (NaN: nothing).
// Returns its weight.
template <bool kHasLost, typename Noise>
HWY_INLINE V add_sample(const Noise& noise, const Sample& model, V measured, Sums& s) {
  const V t = model.by_logit, l = model.by_log, p = model.by_phase;
  V w = reciprocal(noise.variance(model.value));
  V residual = hn::Sub(measured, model.value);
  if constexpr (kHasLost) {
    const M is_there = hn::Eq(measured, measured);
    w = hn::IfThenElseZero(is_there, w);
    residual = hn::IfThenElseZero(is_there, residual);
  }
  const V wt = hn::Mul(w, t), wl = hn::Mul(w, l), wp = hn::Mul(w, p), we = hn::Mul(w, residual);
  s.w = hn::Add(s.w, w);
  s.t = hn::Add(s.t, wt);
  s.l = hn::Add(s.l, wl);
  s.p = hn::Add(s.p, wp);
  s.e = hn::Add(s.e, we);
  s.tt = hn::MulAdd(wt, t, s.tt);
  s.tl = hn::MulAdd(wt, l, s.tl);
  s.tp = hn::MulAdd(wt, p, s.tp);
  s.ll = hn::MulAdd(wl, l, s.ll);
  s.lp = hn::MulAdd(wl, p, s.lp);
  s.pp = hn::MulAdd(wp, p, s.pp);
  s.et = hn::MulAdd(we, t, s.et);
  s.el = hn::MulAdd(we, l, s.el);
  s.ep = hn::MulAdd(we, p, s.ep);
  s.ee = hn::MulAdd(we, residual, s.ee);
  return w;
}

// Adds `count` samples up: the model's, and what was measured (NaN: nothing). Apart from what makes
// the samples, so that the sums stay in registers.
template <bool kHasLost, typename Noise>
HWY_NOINLINE void add_samples_of(const Noise& given, const V* measured, std::size_t count,
                                 Samples& samples, Sums& sums) {
  const Noise noise = given;
  Sums s;
  clear(s);
  for (std::size_t j = 0; j < count; ++j)
    samples.weight[j] = add_sample<kHasLost>(noise, samples.at[j], measured[j], s);
  sums = s;
}

template <bool kHasLost>
HWY_INLINE void add_samples(const NoiseOfPixel& noise, const V* measured, std::size_t count,
                            Samples& samples, Sums& sums) {
  if (noise.count == 2)
    add_samples_of<kHasLost>(NoiseOfTwo(noise), measured, count, samples, sums);
  else
    add_samples_of<kHasLost>(noise, measured, count, samples, sums);
}

// The normal equations solved without the mean, whose row is eliminated.
struct Solution {
  V pp, tp, lp, tt, tl, ll;  // covariance of phase, t, ln l
  V t, l, p, mean;           // the step
  V length;                  // squared, in standard deviations; also the descent of chi-square
  V mean_t, mean_l, mean_p;  // what the mean loses per unit of each
  M is_definite;
};

HWY_INLINE Solution solve(const BatchPlan& plan, Sums s, V mean_slope) {
  const D d;
  Solution x;
  const V per_w = hn::Div(hn::Set(d, 1.0F), s.w);
  V e = s.e;
  if (plan.is_free) {
    x.mean_t = hn::Mul(s.t, per_w);
    x.mean_l = hn::Mul(s.l, per_w);
    x.mean_p = hn::Mul(s.p, per_w);
    s.tt = hn::NegMulAdd(s.t, x.mean_t, s.tt);
    s.tl = hn::NegMulAdd(s.t, x.mean_l, s.tl);
    s.tp = hn::NegMulAdd(s.t, x.mean_p, s.tp);
    s.ll = hn::NegMulAdd(s.l, x.mean_l, s.ll);
    s.lp = hn::NegMulAdd(s.l, x.mean_p, s.lp);
    s.pp = hn::NegMulAdd(s.p, x.mean_p, s.pp);
    s.et = hn::NegMulAdd(e, x.mean_t, s.et);
    s.el = hn::NegMulAdd(e, x.mean_l, s.el);
    s.ep = hn::NegMulAdd(e, x.mean_p, s.ep);
  } else {
    // The mean follows t; its column joins that of t.
    x.mean_t = x.mean_l = x.mean_p = hn::Zero(d);
    s.tt = hn::MulAdd(mean_slope, hn::MulAdd(mean_slope, s.w, hn::Add(s.t, s.t)), s.tt);
    s.tl = hn::MulAdd(mean_slope, s.l, s.tl);
    s.tp = hn::MulAdd(mean_slope, s.p, s.tp);
    s.et = hn::MulAdd(mean_slope, e, s.et);
  }
  // L D L^T in the order phase, t, ln l.
  const V one = hn::Set(d, 1.0F);
  const V per_p = hn::Div(one, s.pp);
  const V tp = hn::Mul(s.tp, per_p), lp = hn::Mul(s.lp, per_p);
  const V pivot_t = hn::NegMulAdd(tp, s.tp, s.tt);
  const V tl_left = hn::NegMulAdd(lp, s.tp, s.tl);
  const V per_t = hn::Div(one, pivot_t);
  const V lt = hn::Mul(tl_left, per_t);
  const V pivot_l = hn::NegMulAdd(lt, tl_left, hn::NegMulAdd(lp, s.lp, s.ll));
  const V per_l = hn::Div(one, pivot_l);
  const V least = hn::Set(d, kLeastPivot);
  x.is_definite = hn::And(
      hn::And(hn::Gt(s.pp, hn::Zero(d)), hn::Gt(s.w, hn::Zero(d))),
      hn::And(hn::Gt(pivot_t, hn::Mul(least, s.tt)), hn::Gt(pivot_l, hn::Mul(least, s.ll))));
  const V q = hn::MulSub(tp, lt, lp);
  x.ll = per_l;
  x.tl = hn::Neg(hn::Mul(lt, per_l));
  x.tt = hn::NegMulAdd(lt, x.tl, per_t);
  x.lp = hn::Mul(q, per_l);
  x.tp = hn::NegMulAdd(tp, per_t, hn::Mul(q, x.tl));
  x.pp = hn::MulAdd(q, x.lp, hn::MulAdd(hn::Mul(tp, tp), per_t, per_p));
  x.t = hn::MulAdd(x.tt, s.et, hn::MulAdd(x.tl, s.el, hn::Mul(x.tp, s.ep)));
  x.l = hn::MulAdd(x.tl, s.et, hn::MulAdd(x.ll, s.el, hn::Mul(x.lp, s.ep)));
  x.p = hn::MulAdd(x.tp, s.et, hn::MulAdd(x.lp, s.el, hn::Mul(x.pp, s.ep)));
  x.length = hn::MulAdd(x.t, s.et, hn::MulAdd(x.l, s.el, hn::Mul(x.p, s.ep)));
  x.mean = hn::Zero(d);
  if (plan.is_free) {
    const V own = hn::Mul(e, per_w);
    x.length = hn::MulAdd(own, e, x.length);
    x.mean = hn::NegMulAdd(x.mean_t, x.t,
                           hn::NegMulAdd(x.mean_l, x.l, hn::NegMulAdd(x.mean_p, x.p, own)));
  }
  return x;
}

// Weighted sums over the samples of something that is added to them.
struct ShiftSums {
  V e, et, el, ep;
};

//   step  from one shift's sample to the next one's
HWY_INLINE ShiftSums sums_of(const Samples& samples, const V* shifts, std::size_t count,
                             std::size_t step) {
  const V zero = hn::Zero(D());
  ShiftSums s{zero, zero, zero, zero};
  for (std::size_t j = 0; j < count; ++j) {
    const Sample& model = samples.at[j * step];
    const V weighted = hn::Mul(samples.weight[j * step], shifts[j]);
    s.e = hn::Add(s.e, weighted);
    s.et = hn::MulAdd(weighted, model.by_logit, s.et);
    s.el = hn::MulAdd(weighted, model.by_log, s.el);
    s.ep = hn::MulAdd(weighted, model.by_phase, s.ep);
  }
  return s;
}

// Squared length of a change of (t, ln l, mean, phase) in standard deviations.
HWY_INLINE V squared_length(const Sums& s, V t, V l, V mean, V p) {
  const auto times_2 = [](V a, V b) HWY_ATTR { return hn::Mul(hn::Add(a, a), b); };
  V length = hn::MulAdd(hn::Mul(t, t), s.tt, hn::Mul(hn::Mul(l, l), s.ll));
  length = hn::MulAdd(hn::Mul(p, p), s.pp, length);
  length = hn::MulAdd(hn::Mul(mean, mean), s.w, length);
  const V mixed = hn::MulAdd(l, s.tl, hn::Mul(p, s.tp));
  length = hn::Add(length, times_2(t, mixed));
  length = hn::Add(length, times_2(hn::Mul(l, p), s.lp));
  const V with_mean = hn::MulAdd(t, s.t, hn::MulAdd(l, s.l, hn::Mul(p, s.p)));
  return hn::Add(length, times_2(mean, with_mean));
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
