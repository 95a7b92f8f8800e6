// What a vector of pixels brings along, and where its search starts.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_START_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_START_INL_H
#undef SSRIG_BATCH_START_INL_H
#else
#define SSRIG_BATCH_START_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_vectors-inl.h"
#include "estimation/profile/batch_waves-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// As in likelihood_pixel.cpp.
constexpr float kLeastContrast = 12, kDarkSnr = 5;
constexpr float kAbsurdReflectance = 1e6F;
// What a vector of pixels brings along.
struct Pixels {
  V position_px;  // less origin and half a stripe, in [0, P)
  V level;        // f_0 (d + b)
  V noise_sd;     // of the darkest sample
  NoiseOfPixel noise;
  V measured[kMostBatchSamples];  // reflectance factors by j; NaN: lost
  V present;                      // how many are not
  M is_usual;                     // nothing for fit_pixel so far
  M is_complete;                  // no sample lost
  bool has_lost;
};

// The unknowns of the search; `mean` is that of the samples, level * (R_d + B).
struct State {
  V logit, log, mean, phase_px;
};

struct Reflectance {
  V value, slope;  // R_d and dR_d/dt
};

HWY_INLINE Reflectance reflectance_at(V logit) {
  const D d;
  const V one = hn::Set(d, 1.0F);
  const V decline = hn::Exp(d, hn::Neg(hn::Abs(logit)));
  const V small = hn::Div(decline, hn::Add(one, decline));  // R_d or 1 - R_d, the lesser
  const V large = hn::Div(one, hn::Add(one, decline));
  return {hn::IfThenElse(hn::Lt(logit, hn::Zero(d)), small, large), hn::Mul(small, large)};
}

HWY_NOINLINE void load_pixels(const BatchPlan& plan, const SweepBasis& basis,
                              const PixelBatch& batch, std::size_t first, Pixels& pixels) {
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
    const V factor = factor_of(batch, 0, first).re;
    pixels.level = hn::Mul(pixels.level, factor);
    pixels.is_usual = hn::And(pixels.is_usual, hn::And(hn::Gt(factor, zero), hn::Lt(factor, huge)));
  }
  pixels.noise.load(plan, safe_full, per_full);
  V least = huge, greatest = zero;
  M all = hn::Eq(zero, zero);
  for (std::size_t j = 0; j < basis.sample_count; ++j) {
    const auto row = static_cast<std::size_t>(basis.row_of[j]);
    const V sample =
        hn::Mul(hn::LoadU(d, batch.samples.data() + row * batch.stride + first), per_full);
    pixels.measured[j] = sample;
    all = hn::And(all, hn::Eq(sample, sample));
    least = hn::Min(least, sample);
    greatest = hn::Max(greatest, hn::Abs(sample));
  }
  pixels.present = hn::Set(d, static_cast<float>(basis.sample_count));
  pixels.has_lost = !hn::AllTrue(d, all);
  pixels.is_complete = all;
  if (pixels.has_lost) {
    pixels.present = zero;
    least = huge;
    greatest = zero;
    for (std::size_t j = 0; j < basis.sample_count; ++j) {
      const V sample = pixels.measured[j];
      const M is_there = hn::Eq(sample, sample);
      pixels.present = hn::Add(pixels.present, hn::IfThenElseZero(is_there, one));
      greatest = hn::Max(greatest, hn::IfThenElseZero(is_there, hn::Abs(sample)));
      least = hn::IfThenElse(is_there, hn::Min(least, sample), least);
    }
  }
  pixels.is_usual = hn::And(pixels.is_usual, hn::Lt(greatest, hn::Set(d, kAbsurdReflectance)));
  // A pixel that lost much of its sweep has an uncertain start.
  const V enough = hn::Set(d, 0.6F * static_cast<float>(basis.sample_count));
  pixels.is_usual = hn::And(pixels.is_usual, hn::Ge(pixels.present, enough));
  pixels.noise_sd = hn::Sqrt(pixels.noise.variance(hn::Max(least, zero)));
}

// Whether a first step is taken on the first harmonics of the data.
HWY_INLINE bool has_first_step(const BatchPlan& plan, const SweepBasis& basis) {
  return basis.is_quartered && plan.first != nullptr;
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

//   data  the first harmonics of the samples, where a first step takes them
HWY_NOINLINE Start start(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                         std::size_t first, Pixels& pixels, Bins<1>& data) {
  const D d;
  const V zero = hn::Zero(d);
  V bridged[kMostBatchSamples];
  const V* samples = pixels.measured;
  if (pixels.has_lost) {
    bridge_gaps(basis.sample_count, pixels.measured, bridged);
    samples = bridged;
  }
  const auto second = static_cast<std::size_t>(basis.second);
  V g[5] = {zero, zero, zero, zero, zero};
  if (has_first_step(plan, basis)) {
    harmonics_of<kFirstHarmonics>(basis, samples, data);
    g[0] = data.parts[0][0];
    for (std::size_t part = 0; part < 2; ++part) {
      g[1 + part] = data.parts[1][part];
      g[3 + part] = data.parts[second][part];
    }
  } else {
    for (std::size_t j = 0; j < basis.sample_count; ++j)
      for (std::size_t i = 0; i < 5; ++i)
        g[i] = hn::MulAdd(hn::Set(d, basis.start[i][j]), samples[j], g[i]);
  }

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
    const M is_exempt = basis.is_quartered ? pixels.is_complete : hn::Lt(zero, zero);
    pixels.is_usual = hn::AndNot(hn::AndNot(is_exempt, is_near), pixels.is_usual);
  }

  // Without the optics' factors and at phase 0.
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

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
