// Gauss-Newton on the samples with the weights of the model, as fit_pixel does it, a vector of
// pixels at a time. Each step takes the model's harmonics from the table (a pixel's lie side by
// side there, and are transposed), makes them samples (a quarter of the waves does where the sweep
// is even) and adds those up to the normal equations; no sample of the model is stored. A
// pixel's steps, a little over two on average, take 0.26 to 0.3 us of a Zen 4 core.
// Taking off the bias of curvature takes a further 0.06 to 0.1 us.
#include "estimation/profile/batch_kernel.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "estimation/session/maps.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/profile/batch_kernel.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_normal-inl.h"
#include "estimation/profile/batch_rescue-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// As in likelihood_pixel.cpp.
constexpr float kLeastContrast = 12, kDarkSnr = 5;
// Harmonics of this share of a sample's noise are left out: they move a pixel's estimates by less
// than 1e-3 standard deviations. Where shifts are few or uneven they pass for lower ones.
constexpr float kToleranceOfNoise = 0.015F, kToleranceIfAliased = 0.01F;
constexpr std::size_t kFewestUnaliased = 32;
// A table that lacks larger ones is too short.
constexpr float kTruncation = 0.05F;
// The first step may be rough: it leaves forty times as much out.
constexpr float kRough = 40;
constexpr float kGreatestLogVariance = 0.09F, kGreatestCondition = 1e5F;
constexpr float kAbsurdReflectance = 1e6F;
// A search ends when what would remain of it, judged by how much shorter this step is than the one
// before, is below a thousandth of a standard deviation. Squared, as are the steps' lengths; the
// step before the first counts as one standard deviation.
constexpr float kGreatestRest = 1e-6F, kFirstLength = 1, kSlowestEnd = 0.25F;
constexpr float kGreatestLogitStep = 1, kGreatestLogStep = 0.75F;
constexpr int kMostSteps = 12;
// Of a correction for bias, as in likelihood_pixel.cpp.
constexpr float kGreatestCorrection = 0.5F;
// Thresholds that single precision may see on the wrong side are for fit_pixel.
constexpr float kMargin = 0.02F;

HWY_INLINE void load_pixels(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                            std::size_t first, Pixels& pixels) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0F);
  const float period_px = static_cast<float>(plan.shape.period_px);
  const V full = hn::LoadU(d, batch.full_signal.data() + first);
  const V position = hn::LoadU(d, batch.position_px.data() + first);
  const V huge = hn::Set(d, 1e30F);
  pixels.is_usual =
      hn::And(hn::And(hn::Gt(full, hn::Set(d, 1e-15F)), hn::Lt(full, hn::Set(d, 1e15F))),
              hn::Lt(hn::Abs(position), hn::Set(d, 1e6F)));
  const V safe_full = hn::IfThenElse(pixels.is_usual, full, one);
  const V per_full = hn::Div(one, safe_full);
  const V whole = hn::Floor(hn::Mul(position, hn::Set(d, 1 / period_px)));
  const float half_px = 0.5F * static_cast<float>(plan.shape.width_px - 1);
  pixels.position_px = hn::IfThenElseZero(
      pixels.is_usual, hn::Sub(hn::NegMulAdd(whole, hn::Set(d, period_px), position),
                               hn::Set(d, half_px + basis.origin_px)));
  const float duty = static_cast<float>(plan.shape.width_px) / period_px;
  pixels.level = hn::Set(d, duty + plan.projector_black_frac);
  if (!batch.factor_re.empty()) {
    const V factor = hn::LoadU(d, batch.factor_re.data() + first);
    pixels.level = hn::Mul(pixels.level, factor);
    pixels.is_usual = hn::And(pixels.is_usual, hn::And(hn::Gt(factor, zero), hn::Lt(factor, huge)));
  }
  pixels.noise.load(plan, safe_full, per_full);
  pixels.present = zero;
  V least = huge;
  M all = hn::Eq(zero, zero);
  for (std::size_t j = 0; j < basis.sample_count; ++j) {
    const auto row = static_cast<std::size_t>(basis.row_of[j]);
    const V sample =
        hn::Mul(hn::LoadU(d, batch.samples.data() + row * batch.stride + first), per_full);
    pixels.measured[j] = sample;
    const M is_there = hn::Eq(sample, sample);
    all = hn::And(all, is_there);
    pixels.present = hn::Add(pixels.present, hn::IfThenElseZero(is_there, one));
    const V size = hn::IfThenElseZero(is_there, hn::Abs(sample));
    pixels.is_usual = hn::And(pixels.is_usual, hn::Lt(size, hn::Set(d, kAbsurdReflectance)));
    least = hn::IfThenElse(is_there, hn::Min(least, sample), least);
  }
  pixels.has_lost = !hn::AllTrue(d, all);
  // A pixel that lost much of its sweep has an uncertain start.
  const V enough = hn::Set(d, 0.6F * static_cast<float>(basis.sample_count));
  pixels.is_usual = hn::And(pixels.is_usual, hn::Ge(pixels.present, enough));
  pixels.noise_sd = hn::Sqrt(pixels.noise.variance(hn::Max(least, zero)));
}

// Lost samples as their neighbours' mean, for the start only.
HWY_INLINE void bridge_gaps(std::size_t count, const V* measured, V* bridged) {
  const D d;
  V before = hn::Zero(d);
  for (std::size_t pass = 0; pass < 2; ++pass)  // the second one knows what precedes the first
    for (std::size_t j = 0; j < count; ++j) {
      before = hn::IfThenElse(hn::Eq(measured[j], measured[j]), measured[j], before);
      bridged[j] = before;
    }
  V after = bridged[0];
  for (std::size_t j = count; j-- > 0;) {
    const M is_there = hn::Eq(measured[j], measured[j]);
    after = hn::IfThenElse(is_there, measured[j], after);
    bridged[j] = hn::Mul(hn::Set(d, 0.5F), hn::Add(bridged[j], after));
  }
}

// Bilinear in the grid of starts.
HWY_INLINE void look_up(const StartGrid& grid, V x, V y, State& state) {
  const D d;
  const V last = hn::Set(d, static_cast<float>(StartGrid::kSide - 1) - 1e-3F);
  const auto place = [&](V value, float first, float per) HWY_ATTR {
    return hn::Min(
        hn::Max(hn::Mul(hn::Sub(value, hn::Set(d, first)), hn::Set(d, per)), hn::Zero(d)), last);
  };
  const V at_x = place(x, grid.first_x, grid.per_x), at_y = place(y, grid.first_y, grid.per_y);
  const V cell_x = hn::Floor(at_x), cell_y = hn::Floor(at_y);
  const V in_x = hn::Sub(at_x, cell_x), in_y = hn::Sub(at_y, cell_y);
  const DI di;
  const auto index = hn::ConvertTo(
      di, hn::MulAdd(cell_x, hn::Set(d, static_cast<float>(StartGrid::kSide)), cell_y));
  const auto mix = [&](const float* values) HWY_ATTR {
    const V v00 = hn::GatherIndex(d, values, index), v01 = hn::GatherIndex(d, values + 1, index);
    const V v10 = hn::GatherIndex(d, values + StartGrid::kSide, index);
    const V v11 = hn::GatherIndex(d, values + StartGrid::kSide + 1, index);
    const V v0 = hn::MulAdd(in_y, hn::Sub(v01, v00), v00);
    const V v1 = hn::MulAdd(in_y, hn::Sub(v11, v10), v10);
    return hn::MulAdd(in_x, hn::Sub(v1, v0), v0);
  };
  state.logit = mix(grid.logit.data());
  state.log = mix(grid.log.data());
}

// Reasons not to fit at all, and the start of the others.
struct Start {
  State state;
  M is_dark, is_flat;  // too little contrast to fit
};

HWY_INLINE Start start(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                       std::size_t first, Pixels& pixels) {
  const D d;
  const V zero = hn::Zero(d);
  V bridged[kMostBatchSamples];
  const V* samples = pixels.measured;
  if (pixels.has_lost) {
    bridge_gaps(basis.sample_count, pixels.measured, bridged);
    samples = bridged;
  }
  V g[5] = {zero, zero, zero, zero, zero};
  for (std::size_t j = 0; j < basis.sample_count; ++j)
    for (std::size_t i = 0; i < 5; ++i)
      g[i] = hn::MulAdd(hn::Set(d, basis.start[i][j]), samples[j], g[i]);

  Start s;
  const V variance = pixels.noise.variance(g[0]);
  const V power = hn::MulAdd(g[1], g[1], hn::Mul(g[2], g[2]));
  const V threshold = hn::Mul(variance, hn::Set(d, kLeastContrast * basis.start_variance));
  const M is_weak = hn::Lt(power, threshold);
  const M is_below = hn::Lt(g[0], hn::Mul(hn::Set(d, kDarkSnr), hn::Sqrt(variance)));
  s.is_dark = hn::And(is_weak, is_below);
  s.is_flat = hn::AndNot(is_below, is_weak);
  if (!basis.is_quartered || pixels.has_lost) {  // the threshold depends on the pixel
    const M is_near = hn::And(hn::Lt(power, hn::Mul(threshold, hn::Set(d, 3.0F))),
                              hn::Gt(power, hn::Mul(threshold, hn::Set(d, 0.3F))));
    const M is_complete =
        hn::Eq(pixels.present, hn::Set(d, static_cast<float>(basis.sample_count)));
    const M is_exempt = basis.is_quartered ? is_complete : hn::Lt(zero, zero);
    pixels.is_usual = hn::AndNot(hn::AndNot(is_exempt, is_near), pixels.is_usual);
  }

  // Without the optics' factors and at phase 0.
  const auto second = static_cast<std::size_t>(basis.second);
  const Complex f1 = factor_of(batch, 1, first), f2 = factor_of(batch, second, first);
  const V power1 = hn::MulAdd(f1.re, f1.re, hn::Mul(f1.im, f1.im));
  const V power2 = hn::MulAdd(f2.re, f2.re, hn::Mul(f2.im, f2.im));
  const V tiny = hn::Set(d, 1e-12F);
  pixels.is_usual = hn::And(pixels.is_usual, hn::And(hn::Gt(power1, tiny), hn::Gt(power2, tiny)));
  const Complex turned = times_conjugate({g[1], g[2]}, f1);
  const V size = hn::Sqrt(hn::MulAdd(turned.re, turned.re, hn::Mul(turned.im, turned.im)));
  const V per_size = hn::Div(hn::Set(d, 1.0F), hn::Max(size, hn::Set(d, 1e-20F)));
  const Complex unit{hn::Mul(turned.re, per_size), hn::Mul(turned.im, per_size)};
  Complex unit_second = times(unit, unit);
  if (basis.second == 3) unit_second = times(unit_second, unit);
  const Complex turned2 = times_conjugate(times_conjugate({g[3], g[4]}, f2), unit_second);
  const V half = hn::Set(d, 0.5F);  // G_n = 2 a_n f_n exp(i n theta)
  const V height1 =
      hn::Max(hn::Mul(half, hn::Div(size, hn::Max(power1, tiny))), hn::Set(d, 1e-20F));
  const V height2 = hn::Mul(half, hn::Div(turned2.re, hn::Max(power2, tiny)));

  const float period_px = static_cast<float>(plan.shape.period_px);
  const V turns = hn::Sub(turn_of(unit), hn::Mul(pixels.position_px, hn::Set(d, 1 / period_px)));
  s.state.phase_px = hn::Mul(hn::Sub(turns, hn::Round(turns)), hn::Set(d, period_px));
  s.state.mean = g[0];
  V y;
  if (plan.is_free) {
    const V ratio = hn::Max(hn::Div(height2, hn::Mul(height1, hn::Set(d, plan.start->sharp_ratio))),
                            hn::Set(d, 1e-12F));
    const V decay =
        hn::Max(hn::Neg(hn::Log(d, ratio)), hn::Set(d, static_cast<float>(StartGrid::kLeastDecay)));
    y = hn::Log(d, decay);
  } else {
    const V share = hn::Min(hn::Max(hn::Div(g[0], hn::Max(pixels.level, tiny)), hn::Set(d, 1e-6F)),
                            hn::Set(d, 0.9999F));
    y = hn::Log(d, hn::Div(share, hn::Sub(hn::Set(d, 1.0F), share)));
  }
  look_up(*plan.start, hn::Log(d, height1), y, s.state);
  return s;
}

struct Outcome {
  State state;
  V indirect;
  V covariance[10];
  V chi_square;
  M is_valid, is_hidden;  // identifiable, surely not; fit_pixel decides the rest
};

// The results where the search has ended.
HWY_INLINE void finish(const BatchPlan& plan, const Pixels& pixels, const Sums& s,
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

// Takes off what curvature adds on average, as Fit::unbiased in likelihood_pixel.cpp does it: one
// more step with the samples' expected shift as their residual.
//   weights  [j] of the samples at the point evaluated last, `at`
//   next     where the search ended
template <bool kQuartered>
HWY_INLINE State unbiased(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                          std::size_t first, const Pixels& pixels, const V* weights,
                          const Sums& sums, const Solution& x, const State& at, const State& next,
                          M where, Harmonics& harmonics) {
  const D d;
  const auto there = [&](V value) HWY_ATTR { return hn::IfThenElseZero(where, value); };
  const Reflectance reflectance = reflectance_at(at.logit);
  const V slope = hn::Mul(pixels.level, reflectance.slope);
  const V half = hn::Set(d, 0.5F);
  const V bend =  // half of R_d'' / R_d' times the variance of t
      there(hn::Mul(hn::Sub(half, reflectance.value), x.tt));
  harmonics.set_expected_shift(batch, basis, first, hn::Add(pixels.position_px, at.phase_px),
                               plan.is_free ? hn::Zero(d) : hn::Mul(slope, bend), there(x.tt),
                               there(x.tl), there(x.ll), there(x.tp), there(x.lp), there(x.pp));
  Sums shifted = sums;
  shifted.e = shifted.et = shifted.el = shifted.ep = hn::Zero(d);
  harmonics.template for_samples<kQuartered>(
      basis, batch, first, [&](std::size_t j, const Sample& model) HWY_ATTR {
        const V shift = hn::Mul(weights[j], model.value);
        shifted.e = hn::Add(shifted.e, shift);
        shifted.et = hn::MulAdd(shift, model.by_logit, shifted.et);
        shifted.el = hn::MulAdd(shift, model.by_log, shifted.el);
        shifted.ep = hn::MulAdd(shift, model.by_phase, shifted.ep);
      });
  const Solution step = solve(plan, shifted, slope);
  const V t = hn::Sub(step.t, bend), l = hn::NegMulAdd(half, x.ll, step.l);
  const V length = squared_length(sums, t, l, plan.is_free ? step.mean : hn::Mul(slope, t), step.p);
  const V greatest = hn::Set(d, kGreatestCorrection);
  const V share = hn::Div(greatest, hn::Max(hn::Sqrt(hn::Max(length, hn::Zero(d))), greatest));
  return {hn::MulAdd(share, t, next.logit), hn::MulAdd(share, l, next.log),
          hn::MulAdd(share, step.mean, next.mean), hn::MulAdd(share, step.p, next.phase_px)};
}

template <bool kQuartered, bool kHasLost>
HWY_INLINE void search(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                       std::size_t first, const Pixels& pixels, const State& from, M active,
                       Harmonics& harmonics, Outcome& out) {
  const D d;
  const ShapeRange& range = plan.table->range();
  const V least_t = hn::Set(d, static_cast<float>(range.least.logit_reflectance)),
          greatest_t = hn::Set(d, static_cast<float>(range.greatest.logit_reflectance)),
          least_l = hn::Set(d, static_cast<float>(range.least.log_translucency_px)),
          greatest_l = hn::Set(d, static_cast<float>(range.greatest.log_translucency_px));
  const bool is_aliased = !basis.is_quartered || basis.sample_count < kFewestUnaliased;
  harmonics.set_tolerance(
      plan, batch, first,
      hn::Mul(pixels.noise_sd, hn::Set(d, is_aliased ? kToleranceIfAliased : kToleranceOfNoise)),
      hn::Mul(pixels.noise_sd, hn::Set(d, kTruncation)));
  State state = from, next = from;
  V length_before = hn::Set(d, kFirstLength);
  // Lanes whose search has ended stay where they are, so that in the end all are at their last
  // point.
  M ended = hn::Lt(least_t, least_t);
  Sums sums;
  Solution x;
  V weights[kMostBatchSamples];
  for (int count = 0; count < kMostSteps && !hn::AllFalse(d, active); ++count) {
    const Reflectance reflectance = reflectance_at(state.logit);
    if (!plan.is_free) state.mean = hn::Mul(pixels.level, reflectance.value);
    active =
        hn::And(active, harmonics.evaluate(plan, basis, batch, first, state.logit, state.log,
                                           hn::Add(pixels.position_px, state.phase_px), state.mean,
                                           hn::Or(active, ended), count == 0 ? kRough : 1.0F));
    clear(sums);
    harmonics.template for_samples<kQuartered>(
        basis, batch, first, [&](std::size_t j, const Sample& model) HWY_ATTR {
          weights[j] = add_sample<kHasLost>(pixels.noise, model, pixels.measured[j], sums);
        });
    x = solve(plan, sums, hn::Mul(pixels.level, reflectance.slope));
    active = hn::And(active, x.is_definite);
    // Plain steps get nowhere with these.
    if (count >= kPatience)
      active = hn::And(active, hn::Lt(x.ll, hn::Set(d, kHopelessLogVariance)));
    V longest =
        hn::Max(hn::Set(d, 1.0F), hn::Mul(hn::Abs(x.t), hn::Set(d, 1 / kGreatestLogitStep)));
    longest = hn::Max(longest, hn::Mul(hn::Abs(x.l), hn::Set(d, 1 / kGreatestLogStep)));
    longest = hn::Max(
        longest, hn::Mul(hn::Abs(x.p), hn::Set(d, 8 / static_cast<float>(plan.shape.period_px))));
    const V share = hn::Div(hn::Set(d, 1.0F), longest);
    next.logit = hn::MulAdd(x.t, share, state.logit);
    next.log = hn::MulAdd(x.l, share, state.log);
    next.mean = hn::MulAdd(x.mean, share, state.mean);
    next.phase_px = hn::MulAdd(x.p, share, state.phase_px);
    const M is_near =
        hn::Lt(hn::Mul(x.length, x.length), hn::Mul(hn::Set(d, kGreatestRest), length_before));
    const M is_fast = hn::Lt(x.length, hn::Mul(hn::Set(d, kSlowestEnd), length_before));
    const M is_last =
        count == 0 ? hn::Lt(x.length, hn::Zero(d)) : hn::And(active, hn::And(is_near, is_fast));
    length_before = x.length;
    const V held_t = hn::Min(hn::Max(next.logit, least_t), greatest_t),
            held_l = hn::Min(hn::Max(next.log, least_l), greatest_l);
    const M is_inside = hn::And(hn::Eq(held_t, next.logit), hn::Eq(held_l, next.log));
    ended = hn::Or(ended, hn::And(is_last, is_inside));
    // At the border of the table twice in a row: the exact model goes on.
    const M is_stuck = hn::And(hn::Eq(held_t, state.logit), hn::Eq(held_l, state.log));
    active = hn::AndNot(hn::Or(is_last, hn::AndNot(is_inside, is_stuck)), active);
    state.logit = hn::IfThenElse(active, held_t, state.logit);
    state.log = hn::IfThenElse(active, held_l, state.log);
    state.mean = hn::IfThenElse(active, next.mean, state.mean);
    state.phase_px = hn::IfThenElse(active, next.phase_px, state.phase_px);
  }
  if (hn::AllFalse(d, ended)) return;
  const State best = unbiased<kQuartered>(plan, basis, batch, first, pixels, weights, sums, x,
                                          state, next, ended, harmonics);
  finish(plan, pixels, sums, x, reflectance_at(next.logit).slope, best, ended, out);
}

// Not inlined: scenes hardly need it.
template <bool kQuartered>
HWY_NOINLINE void search_again(const BatchPlan& plan, const SweepBasis& basis,
                               const PixelBatch& batch, std::size_t first, const Pixels& pixels,
                               const State& from, M active, Harmonics& harmonics, Outcome& out) {
  const Rescue found =
      rescue<kQuartered>(plan, basis, batch, first, pixels, from, active, harmonics);
  out.is_hidden = hn::Or(out.is_hidden, found.is_hopeless);
  search<kQuartered, true>(plan, basis, batch, first, pixels, found.state, found.is_near, harmonics,
                           out);
}

HWY_INLINE void store(const BatchPlan& plan, const Pixels& pixels, const Start& begun,
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

void fit_all_vectors(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                     BatchFit& fit) {
  const D d;
  const V zero = hn::Zero(d);
  Pixels pixels;
  Harmonics harmonics;
  for (std::size_t first = 0; first < batch.count; first += kLanes) {
    load_pixels(plan, basis, batch, first, pixels);
    const Start begun = start(plan, basis, batch, first, pixels);
    const M exists = hn::FirstN(d, batch.count - first);
    const M active =
        hn::And(hn::And(pixels.is_usual, exists), hn::Not(hn::Or(begun.is_dark, begun.is_flat)));
    Outcome out;
    out.state = begun.state;
    out.indirect = out.chi_square = zero;
    for (V& c : out.covariance) c = zero;
    out.is_valid = out.is_hidden = hn::Lt(zero, zero);
    if (basis.is_quartered && !pixels.has_lost)
      search<true, false>(plan, basis, batch, first, pixels, begun.state, active, harmonics, out);
    else if (basis.is_quartered)
      search<true, true>(plan, basis, batch, first, pixels, begun.state, active, harmonics, out);
    else
      search<false, true>(plan, basis, batch, first, pixels, begun.state, active, harmonics, out);
    const M is_left = hn::AndNot(hn::Or(out.is_valid, out.is_hidden), active);
    if (!hn::AllFalse(d, is_left) && basis.is_quartered)
      search_again<true>(plan, basis, batch, first, pixels, begun.state, is_left, harmonics, out);
    else if (!hn::AllFalse(d, is_left))
      search_again<false>(plan, basis, batch, first, pixels, begun.state, is_left, harmonics, out);
    store(plan, pixels, begun, out, first, fit);
  }
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(fit_all_vectors);

void fit_vectors(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                 BatchFit& fit) {
  HWY_DYNAMIC_DISPATCH(fit_all_vectors)(plan, basis, batch, fit);
}

}  // namespace estimation
#endif
