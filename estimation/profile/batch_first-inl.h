// The first step of a long sweep's search, on the first harmonics of its data. Seen from the
// middle of its stripe a pixel's model is even, and its derivative by the phase odd: samples on
// both sides share what they cost, and the phase's equation is apart from the others'. Included
// once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_FIRST_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_FIRST_INL_H
#undef SSRIG_BATCH_FIRST_INL_H
#else
#define SSRIG_BATCH_FIRST_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>
#include <numbers>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_normal-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// From the middle of the stripe to half a period away, both ends included.
constexpr std::size_t kFolded = kFirstSamples / 2 + 1;
static_assert(kFirstSamples % 4 == 0 && 2 * kFirstHarmonics < kFirstSamples);

// A pixel's harmonics as their heights in the data, n = 1 at [0].
using FirstHarmonics = V[kFirstHarmonics];

// The sum of cosines (or sines) times `heights` at all folded samples.
template <bool kIsOdd>
HWY_INLINE void unfold(const SweepBasis& basis, const FirstHarmonics& heights, V mean,
                       V (&out)[kFolded]) {
  const D d;
  FirstHarmonics own;
  for (std::size_t i = 0; i < kFirstHarmonics; ++i) own[i] = heights[i];
  constexpr std::size_t kQuarter = kFirstSamples / 4;
  for (std::size_t j = 0; j <= kQuarter; ++j) {
    const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride + (kIsOdd ? 1 : 0);
    V even = mean, odd = hn::Zero(d);
    for (std::size_t n = 1; n <= kFirstHarmonics; n += 2)
      odd = hn::MulAdd(own[n - 1], hn::Set(d, waves[2 * n]), odd);
    for (std::size_t n = 2; n <= kFirstHarmonics; n += 2)
      even = hn::MulAdd(own[n - 1], hn::Set(d, waves[2 * n]), even);
    out[kFolded - 1 - j] = kIsOdd ? hn::Sub(odd, even) : hn::Sub(even, odd);
    out[j] = hn::Add(even, odd);
  }
}

// A vector of pixels' data as they are seen from where the model has its stripes.
class FoldedSweep {
 public:
  // Without the phases of the factors, which are small.
  HWY_NOINLINE void load(const PixelBatch& batch, std::size_t first, const Bins<1>& data) {
    const D d;
    for (std::size_t n = 1; n <= kFirstHarmonics; ++n) {
      const Complex g{data.parts[n][0], data.parts[n][1]}, f = factor_of(batch, n, first);
      const V power = hn::MulAdd(f.re, f.re, hn::MulAdd(f.im, f.im, hn::Set(d, 1e-20F)));
      const V per_size = hn::ApproximateReciprocalSqrt(power);
      const Complex turned = times_conjugate(g, f);
      data_[n - 1] = {hn::Mul(turned.re, per_size), hn::Mul(turned.im, per_size)};
      factors_[n - 1] = hn::Mul(hn::Set(d, 2.0F), hn::Mul(power, per_size));
    }
    mean_ = data.parts[0][0];
  }

  // The normal equations at a state, of one side of the stripe.
  HWY_NOINLINE Sums at(const BatchPlan& plan, const Pixels& pixels, const State& state,
                       Harmonics& harmonics) {
    const D d;
    const float per_period = 1 / static_cast<float>(plan.shape.period_px);
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period;
    const Complex turn =
        unit_at(hn::Mul(hn::Add(pixels.position_px, state.phase_px), hn::Set(d, per_period)));
    FirstHarmonics value, by_logit, by_log, by_phase, even, odd;
    harmonics.get_first(plan, state.logit, state.log, value, by_logit, by_log);
    Complex unit = turn;
    for (std::size_t i = 0; i < kFirstHarmonics; ++i) {
      const Complex seen = times_conjugate(data_[i], unit);
      unit = times(unit, turn);
      value[i] = hn::Mul(value[i], factors_[i]);
      by_logit[i] = hn::Mul(by_logit[i], factors_[i]);
      by_log[i] = hn::Mul(by_log[i], factors_[i]);
      by_phase[i] = hn::Mul(value[i], hn::Set(d, static_cast<float>(i + 1) * wave_per_px));
      even[i] = hn::Sub(seen.re, value[i]);
      odd[i] = seen.im;
    }
    const SweepBasis& basis = *plan.first;
    const V zero = hn::Zero(d);
    unfold<false>(basis, value, state.mean, value_);
    unfold<false>(basis, by_logit, zero, by_logit_);
    unfold<false>(basis, by_log, zero, by_log_);
    unfold<false>(basis, even, hn::Sub(mean_, state.mean), even_);
    unfold<true>(basis, by_phase, zero, by_phase_);
    unfold<true>(basis, odd, zero, odd_);
    return pixels.noise.count == 2 ? add_up(NoiseOfTwo(pixels.noise)) : add_up(pixels.noise);
  }

 private:
  template <typename Noise>
  HWY_NOINLINE Sums add_up(const Noise& given) const {
    const D d;
    const Noise noise = given;
    Sums s;
    clear(s);
    for (std::size_t j = 0; j < kFolded; ++j) {
      V w = reciprocal(noise.variance(value_[j]));
      if (j == 0 || j + 1 == kFolded) w = hn::Mul(w, hn::Set(d, 0.5F));  // on either side
      const V t = by_logit_[j], l = by_log_[j], p = by_phase_[j];
      const V wt = hn::Mul(w, t), wl = hn::Mul(w, l), wp = hn::Mul(w, p);
      s.w = hn::Add(s.w, w);
      s.t = hn::Add(s.t, wt);
      s.l = hn::Add(s.l, wl);
      s.tt = hn::MulAdd(wt, t, s.tt);
      s.tl = hn::MulAdd(wt, l, s.tl);
      s.ll = hn::MulAdd(wl, l, s.ll);
      s.pp = hn::MulAdd(wp, p, s.pp);
      s.e = hn::MulAdd(w, even_[j], s.e);
      s.et = hn::MulAdd(wt, even_[j], s.et);
      s.el = hn::MulAdd(wl, even_[j], s.el);
      s.ep = hn::MulAdd(wp, odd_[j], s.ep);
    }
    return s;
  }

  Complex data_[kFirstHarmonics];
  FirstHarmonics factors_;  // 2 |f_n|
  V mean_;
  V value_[kFolded], by_logit_[kFolded], by_log_[kFolded], by_phase_[kFolded];  // of the model
  V even_[kFolded], odd_[kFolded];  // what the data have beyond it
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
