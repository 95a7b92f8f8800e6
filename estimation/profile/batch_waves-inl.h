// From harmonics to the samples of a sweep, and from samples to harmonics.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_WAVES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_WAVES_INL_H
#undef SSRIG_BATCH_WAVES_INL_H
#else
#define SSRIG_BATCH_WAVES_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// Harmonics of several fields, where they appear in the samples: bins[bin][2 f] and [2 f + 1] are
// real and imaginary part of field f.
template <std::size_t kFields>
struct Bins {
  V parts[kMostBatchHarmonics + 1][2 * kFields];
  std::size_t count = 0;  // of bins, the mean's included
};

// A field's values at one sample.
template <std::size_t kFields>
using Fields = V[kFields];

// Sums of cosines and of sines, which samples that share their waves add up with different signs.
template <std::size_t kFields>
struct WaveSums {
  Fields<kFields> cosines, sines;

  HWY_INLINE void clear() {
    for (std::size_t f = 0; f < kFields; ++f) cosines[f] = sines[f] = hn::Zero(D());
  }
  HWY_INLINE void add(const V (&bin)[2 * kFields], V cosine, V sine) {
    for (std::size_t f = 0; f < kFields; ++f) {
      cosines[f] = hn::MulAdd(bin[2 * f], cosine, cosines[f]);
      sines[f] = hn::MulAdd(bin[2 * f + 1], sine, sines[f]);
    }
  }
};

template <std::size_t kFields, typename Add>
HWY_INLINE void add_sum(std::size_t j, const Fields<kFields>& a, const Fields<kFields>& b,
                        const Add& add) {
  Fields<kFields> sum;
  for (std::size_t f = 0; f < kFields; ++f) sum[f] = hn::Add(a[f], b[f]);
  add(j, sum);
}

template <std::size_t kFields, typename Add>
HWY_INLINE void add_difference(std::size_t j, const Fields<kFields>& a, const Fields<kFields>& b,
                               const Add& add) {
  Fields<kFields> difference;
  for (std::size_t f = 0; f < kFields; ++f) difference[f] = hn::Sub(a[f], b[f]);
  add(j, difference);
}

// Samples j, S/2 - j, S/2 + j and S - j of their even and odd harmonics.
template <std::size_t kFields, typename Add>
HWY_INLINE void add_quadruple(std::size_t half, std::size_t j, const WaveSums<kFields>& even,
                              const WaveSums<kFields>& odd, const Add& add) {
  Fields<kFields> near, far, near_sin, far_sin;
  for (std::size_t f = 0; f < kFields; ++f) {
    near[f] = hn::Add(even.cosines[f], odd.cosines[f]);
    far[f] = hn::Sub(even.cosines[f], odd.cosines[f]);
    near_sin[f] = hn::Add(even.sines[f], odd.sines[f]);
    far_sin[f] = hn::Sub(even.sines[f], odd.sines[f]);
  }
  add_sum<kFields>(j, near, near_sin, add);
  add_difference<kFields>(half - j, far, far_sin, add);
  add_sum<kFields>(half + j, far, far_sin, add);
  add_difference<kFields>(2 * half - j, near, near_sin, add);
}

// The quadruples of j and S/4 - j: even harmonics of theirs differ in signs alone.
template <std::size_t kFields, typename Add>
HWY_INLINE void add_pair(const SweepBasis& basis, const Bins<kFields>& bins, std::size_t j,
                         const Add& add) {
  const D d;
  const std::size_t mirror = basis.sample_count / 4 - j;
  const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
  const float* const mirror_waves = basis.waves.data() + 2 * mirror * basis.bin_stride;
  WaveSums<kFields> even, even_mirror;
  {
    WaveSums<kFields> fourth, other;  // n = 0, 2 mod 4
    fourth.clear();
    other.clear();
    for (std::size_t f = 0; f < kFields; ++f) fourth.cosines[f] = bins.parts[0][2 * f];
    for (std::size_t bin = 2; bin < bins.count; bin += 4)
      other.add(bins.parts[bin], hn::Set(d, waves[2 * bin]), hn::Set(d, waves[2 * bin + 1]));
    for (std::size_t bin = 4; bin < bins.count; bin += 4)
      fourth.add(bins.parts[bin], hn::Set(d, waves[2 * bin]), hn::Set(d, waves[2 * bin + 1]));
    for (std::size_t f = 0; f < kFields; ++f) {
      even.cosines[f] = hn::Add(fourth.cosines[f], other.cosines[f]);
      even.sines[f] = hn::Add(fourth.sines[f], other.sines[f]);
      even_mirror.cosines[f] = hn::Sub(fourth.cosines[f], other.cosines[f]);
      even_mirror.sines[f] = hn::Sub(other.sines[f], fourth.sines[f]);
    }
  }
  WaveSums<kFields> odd, odd_mirror;
  odd.clear();
  odd_mirror.clear();
  for (std::size_t bin = 1; bin < bins.count; bin += 2) {
    odd.add(bins.parts[bin], hn::Set(d, waves[2 * bin]), hn::Set(d, waves[2 * bin + 1]));
    odd_mirror.add(bins.parts[bin], hn::Set(d, mirror_waves[2 * bin]),
                   hn::Set(d, mirror_waves[2 * bin + 1]));
  }
  add_quadruple<kFields>(basis.sample_count / 2, j, even, odd, add);
  add_quadruple<kFields>(basis.sample_count / 2, mirror, even_mirror, odd_mirror, add);
}

// Every second bin from `first_bin` on.
template <std::size_t kFields>
HWY_INLINE void add_bins(const Bins<kFields>& bins, const float* waves, std::size_t first_bin,
                         WaveSums<kFields>& sums) {
  const D d;
  for (std::size_t bin = first_bin; bin < bins.count; bin += 2)
    sums.add(bins.parts[bin], hn::Set(d, waves[2 * bin]), hn::Set(d, waves[2 * bin + 1]));
}

// Samples 0 and S/2, which have no sines, S/4 and 3 S/4, whose odd harmonics have no cosines and
// whose even ones no sines.
template <std::size_t kFields, typename Add>
HWY_INLINE void add_ends(const SweepBasis& basis, const Bins<kFields>& bins, const Add& add) {
  const D d;
  const std::size_t quarter = basis.sample_count / 4;
  const float* const waves = basis.waves.data() + 2 * quarter * basis.bin_stride;
  Fields<kFields> even, odd, even_turned, odd_turned;
  for (std::size_t f = 0; f < kFields; ++f) {
    even[f] = even_turned[f] = bins.parts[0][2 * f];
    odd[f] = odd_turned[f] = hn::Zero(d);
  }
  for (std::size_t bin = 1; bin < bins.count; bin += 2) {
    const V sine = hn::Set(d, waves[2 * bin + 1]);
    for (std::size_t f = 0; f < kFields; ++f) {
      odd[f] = hn::Add(odd[f], bins.parts[bin][2 * f]);
      odd_turned[f] = hn::MulAdd(bins.parts[bin][2 * f + 1], sine, odd_turned[f]);
    }
  }
  for (std::size_t bin = 2; bin < bins.count; bin += 2) {
    const V cosine = hn::Set(d, waves[2 * bin]);
    for (std::size_t f = 0; f < kFields; ++f) {
      even[f] = hn::Add(even[f], bins.parts[bin][2 * f]);
      even_turned[f] = hn::MulAdd(bins.parts[bin][2 * f], cosine, even_turned[f]);
    }
  }
  add_sum<kFields>(0, even, odd, add);
  add_difference<kFields>(2 * quarter, even, odd, add);
  add_sum<kFields>(quarter, even_turned, odd_turned, add);
  add_difference<kFields>(3 * quarter, even_turned, odd_turned, add);
}

// Calls add(j, fields) for each sample of an even sweep.
template <std::size_t kFields, typename Add>
HWY_INLINE void for_quartered(const SweepBasis& basis, const Bins<kFields>& bins, const Add& add) {
  add_ends<kFields>(basis, bins, add);
  const std::size_t quarter = basis.sample_count / 4;
  for (std::size_t j = 1; 2 * j < quarter; ++j) add_pair<kFields>(basis, bins, j, add);
  if (quarter % 2 != 0) return;
  const std::size_t middle = quarter / 2;
  const float* const waves = basis.waves.data() + 2 * middle * basis.bin_stride;
  WaveSums<kFields> even, odd;
  even.clear();
  odd.clear();
  for (std::size_t f = 0; f < kFields; ++f) even.cosines[f] = bins.parts[0][2 * f];
  add_bins<kFields>(bins, waves, 1, odd);
  add_bins<kFields>(bins, waves, 2, even);
  add_quadruple<kFields>(2 * quarter, middle, even, odd, add);
}

// The same of any sweep.
template <std::size_t kFields, typename Add>
HWY_INLINE void for_shared_shifts(const SweepBasis& basis, const Bins<kFields>& bins,
                                  const Add& add) {
  for (std::size_t j = 0; j < basis.sample_count; ++j) {
    const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
    WaveSums<kFields> sums;
    sums.clear();
    for (std::size_t f = 0; f < kFields; ++f) sums.cosines[f] = bins.parts[0][2 * f];
    add_bins<kFields>(bins, waves, 1, sums);
    add_bins<kFields>(bins, waves, 2, sums);
    add_sum<kFields>(j, sums.cosines, sums.sines, add);
  }
}

// The same where each pixel's shifts differ: so do its waves, from the nominal ones turned by the
// offset.
template <std::size_t kFields, typename Add>
HWY_INLINE void for_own_offsets(const SweepBasis& basis, const Bins<kFields>& bins,
                                const PixelBatch& batch, std::size_t first, float per_period,
                                const Add& add) {
  const D d;
  for (std::size_t j = 0; j < basis.sample_count; ++j) {
    const auto row = static_cast<std::size_t>(basis.row_of[j]);
    const V offset = hn::LoadU(d, batch.offset_px.data() + row * batch.stride + first);
    const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
    const Complex nominal{hn::Set(d, waves[2]), hn::Set(d, waves[3])};
    const Complex turn = times(nominal, unit_at(hn::Mul(offset, hn::Set(d, per_period))));
    Complex unit = turn;
    WaveSums<kFields> sums;
    sums.clear();
    for (std::size_t f = 0; f < kFields; ++f) sums.cosines[f] = bins.parts[0][2 * f];
    for (std::size_t bin = 1; bin < bins.count; ++bin) {
      sums.add(bins.parts[bin], unit.re, unit.im);
      unit = times(unit, turn);
    }
    add_sum<kFields>(j, sums.cosines, sums.sines, add);
  }
}

// Least squares without weights for the mean and the first kCount harmonics that the samples of an
// even sweep hold.
template <std::size_t kCount>
HWY_INLINE void harmonics_of(const SweepBasis& basis, const V* samples, Bins<1>& bins) {
  const D d;
  const std::size_t half = basis.sample_count / 2, quarter = half / 2;
  const V low = hn::Add(samples[0], samples[half]), low_odd = hn::Sub(samples[0], samples[half]);
  const V high = hn::Add(samples[quarter], samples[half + quarter]),
          high_odd = hn::Sub(samples[quarter], samples[half + quarter]);
  V sum = hn::Add(low, high), re[kCount], im[kCount];
  for (std::size_t n = 1; n <= kCount; ++n) {
    const bool is_turned = n % 4 >= 2;
    re[n - 1] = n % 2 != 0 ? low_odd : is_turned ? hn::Sub(low, high) : hn::Add(low, high);
    im[n - 1] = n % 2 == 0 ? hn::Zero(d) : is_turned ? hn::Neg(high_odd) : high_odd;
  }
  for (std::size_t j = 1; j < quarter; ++j) {
    const V a = samples[j], b = samples[half - j], e = samples[half + j], g = samples[2 * half - j];
    const V near = hn::Add(a, g), far = hn::Add(b, e);
    const V near_sin = hn::Sub(a, g), far_sin = hn::Sub(b, e);
    const V even = hn::Add(near, far), odd = hn::Sub(near, far);
    const V even_sin = hn::Sub(near_sin, far_sin), odd_sin = hn::Add(near_sin, far_sin);
    sum = hn::Add(sum, even);
    const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
    for (std::size_t n = 1; n <= kCount; ++n) {
      const V cosine = hn::Set(d, waves[2 * n]), sine = hn::Set(d, waves[2 * n + 1]);
      re[n - 1] = hn::MulAdd(n % 2 != 0 ? odd : even, cosine, re[n - 1]);
      im[n - 1] = hn::MulAdd(n % 2 != 0 ? odd_sin : even_sin, sine, im[n - 1]);
    }
  }
  const float per_sample = 1 / static_cast<float>(basis.sample_count);
  const V twice = hn::Set(d, 2 * per_sample);
  bins.parts[0][0] = hn::Mul(sum, hn::Set(d, per_sample));
  for (std::size_t n = 1; n <= kCount; ++n) {
    bins.parts[n][0] = hn::Mul(re[n - 1], twice);
    bins.parts[n][1] = hn::Mul(im[n - 1], twice);
  }
  bins.count = kCount + 1;
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
