// What a vector of pixels leaves: estimates, covariance, validity.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_OUTCOME_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_OUTCOME_INL_H
#undef SSRIG_BATCH_OUTCOME_INL_H
#else
#define SSRIG_BATCH_OUTCOME_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_normal-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"
#include "estimation/session/maps.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// As in fisher.cpp.
constexpr float kGreatestLogVariance = 0.25F, kGreatestCondition = 1e5F;
// Thresholds that single precision may see on the wrong side are for fit_pixel.
constexpr float kMargin = 0.02F;
struct Outcome {
  State state;
  V indirect;
  V covariance[10];
  V chi_square;
  M is_valid, is_hidden;  // identifiable, surely not; fit_pixel decides the rest
};

// The results where the search has ended.
HWY_NOINLINE void finish(const BatchPlan& plan, const Pixels& pixels, const Sums& s,
                         const Solution& x, V slope, const State& state, M where, Outcome& out) {
  const D d;
  const V zero = hn::Zero(d);
  V c[10];
  c[0] = x.tt;
  c[1] = x.tl;
  c[2] = x.ll;
  c[3] = c[4] = c[5] = c[8] = zero;
  c[6] = x.tp;
  c[7] = x.lp;
  c[9] = x.pp;
  V trace = hn::MulAdd(s.ll, x.ll, hn::Mul(s.pp, x.pp));
  const V mean_slope = hn::Mul(pixels.level, slope);
  const V t_with_mean =
      hn::MulAdd(mean_slope, hn::MulAdd(mean_slope, s.w, hn::Add(s.t, s.t)), s.tt);
  trace = hn::MulAdd(t_with_mean, x.tt, trace);
  V indirect = zero;
  if (plan.is_free) {
    const V per_level = hn::Div(hn::Set(d, 1.0F), pixels.level);
    // B = mean / level - R_d; the mean's covariance with a is -sum_b mean_b C_ab.
    const auto with_mean = [&](V t, V l, V p) HWY_ATTR {
      return hn::Neg(hn::MulAdd(x.mean_t, t, hn::MulAdd(x.mean_l, l, hn::Mul(x.mean_p, p))));
    };
    const V mean_t = with_mean(x.tt, x.tl, x.tp), mean_l = with_mean(x.tl, x.ll, x.lp),
            mean_p = with_mean(x.tp, x.lp, x.pp);
    const V mean_mean = hn::Add(hn::Div(hn::Set(d, 1.0F), s.w), with_mean(mean_t, mean_l, mean_p));
    c[3] = hn::MulSub(mean_t, per_level, hn::Mul(slope, x.tt));
    c[4] = hn::MulSub(mean_l, per_level, hn::Mul(slope, x.tl));
    c[8] = hn::MulSub(mean_p, per_level, hn::Mul(slope, x.tp));
    const V twice = hn::Mul(hn::Add(per_level, per_level), mean_t);
    c[5] = hn::MulAdd(hn::Mul(per_level, per_level), mean_mean,
                      hn::Mul(slope, hn::MulSub(slope, x.tt, twice)));
    trace = hn::MulAdd(hn::Mul(hn::Mul(pixels.level, pixels.level), s.w), c[5], trace);
    indirect = hn::MulSub(state.mean, per_level, reflectance_at(state.logit).value);
  }
  const auto keep = [&](V& to, V from) HWY_ATTR { to = hn::IfThenElse(where, from, to); };
  for (std::size_t i = 0; i < 10; ++i) keep(out.covariance[i], c[i]);
  keep(out.state.logit, state.logit);
  keep(out.state.log, state.log);
  keep(out.state.phase_px, state.phase_px);
  keep(out.indirect, indirect);
  keep(out.chi_square, hn::Max(hn::Sub(s.ee, x.length), zero));

  const float unknowns = 4;
  const V variance = hn::Set(d, kGreatestLogVariance);
  // A nearly singular matrix may have lost its sign to rounding.
  const M is_positive = hn::Gt(hn::Min(hn::Min(c[0], c[2]), c[9]), zero);
  const M is_possible = plan.is_free ? hn::And(is_positive, hn::Gt(c[5], zero)) : is_positive;
  const M is_sure = hn::And(is_possible, hn::Le(x.ll, hn::Mul(variance, hn::Set(d, 1 - kMargin))));
  const M is_conditioned = hn::Le(trace, hn::Set(d, kGreatestCondition * (1 - kMargin) / unknowns));
  const M is_vague = hn::Gt(x.ll, hn::Mul(variance, hn::Set(d, 1 + kMargin)));
  const M is_singular = hn::Gt(trace, hn::Set(d, kGreatestCondition * (1 + kMargin) * unknowns));
  out.is_valid = hn::Or(out.is_valid, hn::And(where, hn::And(is_sure, is_conditioned)));
  out.is_hidden = hn::Or(out.is_hidden, hn::And(where, hn::Or(is_vague, is_singular)));
}

HWY_NOINLINE void store(const BatchPlan& plan, const Pixels& pixels, const Start& begun,
                        const Outcome& out, std::size_t first, BatchFit& fit) {
  const D d;
  const V zero = hn::Zero(d);
  const auto put = [&](std::vector<float>& row, std::size_t at, V value) HWY_ATTR {
    hn::StoreU(hn::IfThenElseZero(out.is_valid, value), d, row.data() + at);
  };
  put(fit.logit_reflectance, first, out.state.logit);
  put(fit.log_translucency_px, first, out.state.log);
  put(fit.indirect, first, out.indirect);
  put(fit.phase_px, first, out.state.phase_px);
  for (std::size_t i = 0; i < 10; ++i)
    put(fit.covariance, i * fit.stride + first, out.covariance[i]);
  const V freedom = hn::Sub(pixels.present, hn::Set(d, plan.is_free ? 4.0F : 3.0F));
  put(fit.reduced_chi_square, first,
      hn::IfThenElse(hn::Gt(freedom, zero),
                     hn::Div(out.chi_square, hn::Max(freedom, hn::Set(d, 1.0F))),
                     hn::Set(d, 1.0F)));
  const DU du;
  const auto as_bits = [&](M mask) HWY_ATTR { return hn::BitCast(du, hn::VecFromMask(d, mask)); };
  const auto reason = [&](M mask, std::uint32_t bit) HWY_ATTR {
    return hn::And(as_bits(hn::And(mask, pixels.is_usual)), hn::Set(du, bit));
  };
  const M is_settled = hn::And(pixels.is_usual, hn::Or(hn::Or(out.is_valid, out.is_hidden),
                                                       hn::Or(begun.is_dark, begun.is_flat)));
  auto validity = hn::AndNot(as_bits(is_settled), hn::Set(du, kLeftToFitPixel));
  validity = hn::Or(validity, reason(out.is_hidden, kNotIdentifiable));
  validity = hn::Or(validity, reason(begun.is_flat, kNotIdentifiable));
  validity = hn::Or(validity, reason(begun.is_dark, kTooDark));
  hn::StoreU(validity, du, fit.validity.data() + first);
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
