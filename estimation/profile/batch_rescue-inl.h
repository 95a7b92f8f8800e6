// What becomes of pixels that Gauss-Newton left: a damped search, from two starts, as fit_pixel
// searches. Of the pixels of a scene hardly any come here; of what a camera should not give, most,
// and nearly all of those are hopeless, which is seen here at a thirtieth of fit_pixel's cost.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_RESCUE_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_RESCUE_INL_H
#undef SSRIG_BATCH_RESCUE_INL_H
#else
#define SSRIG_BATCH_RESCUE_INL_H
#endif

#include <hwy/highway.h>

#include <cmath>
#include <cstddef>

#include "estimation/profile/batch_normal-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// As in pixel_search.cpp.
constexpr int kPatience = 6;
constexpr float kFirstDamping = 1e-2F, kMoreDamping = 30;
constexpr float kEdgeLogVariance = 0.45F * 0.45F, kHopelessLogVariance = 9;
constexpr float kGreatestDampedLogitStep = 2, kGreatestDampedLogStep = 1.5F;
constexpr float kPeriodsOfSecondStart = 1.0F / 12, kShareOfSecondStart = 0.6F;
// The slow ones would keep their whole vector waiting.
constexpr int kMostDampedSteps = 16;
// Nothing is called hopeless that rounding may have made so.
constexpr float kSurely = 2, kSurelyIfSingular = 4;
// Squared length of a step, in standard deviations, after which plain steps will do; and what of
// chi-square rounding hides.
constexpr float kNearLength = 1e-3F, kRoundingOfChiSquare = 4e-6F;

struct Rescue {
  State state;
  M is_near;      // to a minimum that the table holds: plain steps from `state` reach it
  M is_hopeless;  // l_d cannot be known
};

// One search. Lanes that are neither near nor hopeless are for fit_pixel.
template <bool kQuartered>
HWY_INLINE Rescue search_damped(const BatchPlan& plan, const SweepBasis& basis,
                                const PixelBatch& batch, std::size_t first, const Pixels& pixels,
                                const State& from, M active, Harmonics& harmonics) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0F);
  const ShapeRange& range = plan.table->range();
  const auto held = [&](V value, double least, double greatest) HWY_ATTR {
    return hn::Min(hn::Max(value, hn::Set(d, static_cast<float>(least))),
                   hn::Set(d, static_cast<float>(greatest)));
  };
  const M none = hn::Lt(zero, zero);
  Rescue found{.state = from, .is_near = none, .is_hopeless = none};
  State& state = found.state;
  State trial = from;
  Sums sums, there;  // at `state`, at `trial`
  clear(sums);
  V weights[kMostBatchSamples];  // at `state`
  V trial_weights[kMostBatchSamples];
  V damping = zero;
  M suffices = active, is_leaving = none;
  for (int count = 0; count <= kMostDampedSteps && !hn::AllFalse(d, active); ++count) {
    if (!plan.is_free) trial.mean = hn::Mul(pixels.level, reflectance_at(trial.logit).value);
    const M suffices_there =
        harmonics.evaluate(plan, basis, batch, first, trial.logit, trial.log,
                           hn::Add(pixels.position_px, trial.phase_px), trial.mean, active, 1.0F);
    clear(there);
    V chi_square = zero;  // by the weights of `state`
    harmonics.template for_samples<kQuartered>(
        basis, batch, first, [&](std::size_t j, const Sample& model) HWY_ATTR {
          const V measured = pixels.measured[j];
          trial_weights[j] = add_sample<true>(pixels.noise, model, measured, there);
          if (count == 0) weights[j] = trial_weights[j];
          const V residual =
              hn::IfThenElseZero(hn::Eq(measured, measured), hn::Sub(measured, model.value));
          chi_square = hn::MulAdd(hn::Mul(weights[j], residual), residual, chi_square);
        });
    M is_taken = hn::And(active, hn::Lt(chi_square, sums.ee));
    if (count == 0) is_taken = active;
    const auto take = [&](V& to, V value) HWY_ATTR { to = hn::IfThenElse(is_taken, value, to); };
    for (std::size_t j = 0; j < basis.sample_count; ++j) take(weights[j], trial_weights[j]);
    take_sums(is_taken, there, sums);
    take(state.logit, trial.logit);
    take(state.log, trial.log);
    take(state.mean, trial.mean);
    take(state.phase_px, trial.phase_px);
    suffices = hn::Or(hn::And(is_taken, suffices_there), hn::AndNot(is_taken, suffices));
    const V less = hn::IfThenElseZero(hn::Gt(damping, hn::Set(d, kFirstDamping)),
                                      hn::Mul(damping, hn::Set(d, 1 / kMoreDamping)));
    const V more = hn::Max(hn::Set(d, kFirstDamping), hn::Mul(damping, hn::Set(d, kMoreDamping)));
    if (count > 0) damping = hn::IfThenElse(is_taken, less, more);

    const V slope = hn::Mul(pixels.level, reflectance_at(state.logit).slope);
    const Solution plain = solve(plan, sums, slope);
    // Singular to rounding, even so it descends.
    damping = hn::IfThenElse(plain.is_definite, damping, hn::Max(damping, hn::Set(d, 1e-3F)));
    const Solution x = solve(plan, damped(sums, damping), slope);
    const V surely = hn::IfThenElse(plain.is_definite, hn::Set(d, 1 / kSurely),
                                    hn::Set(d, 1 / kSurelyIfSingular));
    const V log_variance = hn::Mul(hn::Abs(plain.ll), surely);
    const auto is_vague = [&](float limit)
                              HWY_ATTR { return hn::Gt(log_variance, hn::Set(d, limit)); };
    const M is_beyond_the_edge = is_vague(kEdgeLogVariance);
    M hopeless = count >= kPatience ? is_vague(kHopelessLogVariance) : none;
    const V near =
        hn::Max(hn::Set(d, kNearLength), hn::Mul(sums.ee, hn::Set(d, kRoundingOfChiSquare)));
    const M is_last =
        hn::And(hn::And(x.is_definite, hn::Eq(damping, zero)), hn::Lt(x.length, near));
    hopeless = hn::Or(hopeless, hn::And(is_last, hn::AndNot(suffices, is_beyond_the_edge)));
    // Held by the border: what is beyond is known even less.
    const M is_held =
        hn::AndNot(is_taken, hn::And(is_leaving, hn::Gt(damping, hn::Set(d, 2 * kFirstDamping))));
    hopeless = hn::Or(hopeless, hn::And(is_held, is_beyond_the_edge));
    found.is_hopeless = hn::Or(found.is_hopeless, hn::And(active, hopeless));
    found.is_near =
        hn::Or(found.is_near, hn::And(hn::And(active, is_last), hn::AndNot(hopeless, suffices)));
    active = hn::AndNot(hn::Or(hn::Or(is_last, hopeless), is_held), hn::And(active, x.is_definite));

    V longest = hn::Max(one, hn::Mul(hn::Abs(x.t), hn::Set(d, 1 / kGreatestDampedLogitStep)));
    longest = hn::Max(longest, hn::Mul(hn::Abs(x.l), hn::Set(d, 1 / kGreatestDampedLogStep)));
    longest = hn::Max(
        longest, hn::Mul(hn::Abs(x.p), hn::Set(d, 8 / static_cast<float>(plan.shape.period_px))));
    const V share = hn::IfThenElseZero(active, hn::Div(one, longest));
    const auto step = [&](V at, V change) HWY_ATTR {
      return hn::IfThenElse(active, hn::MulAdd(change, share, at), at);
    };
    const V logit = step(state.logit, x.t), log = step(state.log, x.l);
    trial = {held(logit, range.least.logit_reflectance, range.greatest.logit_reflectance),
             held(log, range.least.log_translucency_px, range.greatest.log_translucency_px),
             step(state.mean, x.mean), step(state.phase_px, x.p)};
    is_leaving = hn::Or(hn::Ne(trial.logit, logit), hn::Ne(trial.log, log));
  }
  return found;
}

// From the start that the harmonics gave, then from the middle of what can be told apart. Hopeless
// is what both find so.
template <bool kQuartered>
HWY_INLINE Rescue rescue(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                         std::size_t first, const Pixels& pixels, const State& from, M active,
                         Harmonics& harmonics) {
  const D d;
  const Rescue begun =
      search_damped<kQuartered>(plan, basis, batch, first, pixels, from, active, harmonics);
  if (hn::AllFalse(d, begun.is_hopeless)) return begun;
  const V share =
      hn::Min(hn::Max(hn::Div(hn::Mul(hn::Set(d, kShareOfSecondStart), from.mean), pixels.level),
                      hn::Set(d, 1e-3F)),
              hn::Set(d, 0.9F));
  const ShapeRange& range = plan.table->range();
  const auto held = [&](V value, double least, double greatest) HWY_ATTR {
    return hn::Min(hn::Max(value, hn::Set(d, static_cast<float>(least))),
                   hn::Set(d, static_cast<float>(greatest)));
  };
  const float log = std::log(kPeriodsOfSecondStart * static_cast<float>(plan.shape.period_px));
  const State second{
      held(hn::Log(d, hn::Div(share, hn::Sub(hn::Set(d, 1.0F), share))),
           range.least.logit_reflectance, range.greatest.logit_reflectance),
      held(hn::Set(d, log), range.least.log_translucency_px, range.greatest.log_translucency_px),
      from.mean, from.phase_px};
  const Rescue again = search_damped<kQuartered>(plan, basis, batch, first, pixels, second,
                                                 begun.is_hopeless, harmonics);
  const auto either = [&](V one, V other)
                          HWY_ATTR { return hn::IfThenElse(again.is_near, other, one); };
  return {.state = {either(begun.state.logit, again.state.logit),
                    either(begun.state.log, again.state.log),
                    either(begun.state.mean, again.state.mean),
                    either(begun.state.phase_px, again.state.phase_px)},
          .is_near = hn::Or(begun.is_near, again.is_near),
          .is_hopeless = again.is_hopeless};
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif  // SSRIG_BATCH_RESCUE_INL_H
