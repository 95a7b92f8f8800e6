#include "estimation/geometry/row_kernels.h"

#include <array>
#include <cstdint>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/geometry/row_kernels.cpp"
#include <hwy/foreach_target.h>

// After foreach_target.h, which includes this file once a target.
#include <hwy/cache_control.h>
#include <hwy/contrib/math/math-inl.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Vectors = hn::ScalableTag<float>;
using One = hn::CappedTag<float, 1>;  // what is left at a row's end

template <typename D>
using Of = hn::Vec<D>;

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// Each of the loads asks for the next row's sample too: a row is over before processors have seen
// that it is one, and there are hundreds of them.

// As merge_row does it.
template <typename D>
HWY_INLINE Of<D> merge(D d, std::span<const ExposedRow> exposures, float saturation_dn,
                       std::size_t i) {
  const hn::RebindToSigned<D> di;
  const hn::Rebind<std::uint16_t, D> du;
  const auto saturation = hn::Set(d, saturation_dn);
  auto sum_dn = hn::Zero(d), sum_us = hn::Zero(d);
  for (const ExposedRow& frame : exposures) {
    const auto dn = hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(du, frame.dn + i)));
    const auto usable = hn::Lt(dn, saturation);
    const auto signal = hn::Sub(dn, hn::LoadU(d, frame.black_dn + i));
    sum_dn = hn::Add(sum_dn, hn::IfThenElseZero(usable, signal));
    sum_us = hn::Add(sum_us, hn::IfThenElseZero(usable, hn::Set(d, frame.exposure_us)));
  }
  return hn::IfThenElse(hn::Gt(sum_us, hn::Zero(d)), hn::Div(sum_dn, sum_us), hn::Set(d, kNaN));
}

template <typename D>
HWY_INLINE Of<D> load(D d, const SampleRow& row, float saturation_dn, std::size_t i) {
  if (row.merged != nullptr) {
    hwy::Prefetch(row.merged + static_cast<std::ptrdiff_t>(i) + row.to_next_row);
    return hn::LoadU(d, row.merged + i);
  }
  return merge(d, row.exposures, saturation_dn, i);
}

template <typename D>
HWY_INLINE Of<D> variance_of(D d, std::span<const NoiseRange> ranges, Of<D> sample) {
  const auto lit = hn::Max(sample, hn::Zero(d));
  const NoiseRange& last = ranges.back();
  auto variance = hn::MulAdd(hn::Set(d, last.shot_dn_per_us), lit, hn::Set(d, last.read_variance));
  for (std::size_t k = ranges.size() - 1; k-- > 0;) {
    const auto below =
        hn::MulAdd(hn::Set(d, ranges[k].shot_dn_per_us), lit, hn::Set(d, ranges[k].read_variance));
    const auto is_below = hn::Le(lit, hn::Set(d, ranges[k].up_to_dn_per_us));
    variance = hn::IfThenElse(is_below, below, variance);
  }
  return variance;
}

// Sums over a pattern's frames where none is saturated: whole numbers, so that black, noise and
// exposure need to be seen to but once.
template <typename D>
struct WholeSum {
  hn::Vec<hn::RebindToSigned<D>> dn, most_dn;
};

template <typename D>
HWY_INLINE WholeSum<D> sum_of(D, const SampleRow& row, std::size_t i) {
  const hn::RebindToSigned<D> di;
  const hn::Rebind<std::uint16_t, D> du;
  const std::span<const ExposedRow> exposures = row.exposures;
  for (const ExposedRow& frame : exposures)
    hwy::Prefetch(frame.dn + static_cast<std::ptrdiff_t>(i) + row.to_next_row);
  WholeSum<D> sum{hn::PromoteTo(di, hn::LoadU(du, exposures[0].dn + i)), hn::Zero(di)};
  sum.most_dn = sum.dn;
  for (const ExposedRow& frame : exposures.subspan(1)) {
    const auto dn = hn::PromoteTo(di, hn::LoadU(du, frame.dn + i));
    sum.dn = hn::Add(sum.dn, dn);
    sum.most_dn = hn::Max(sum.most_dn, dn);
  }
  return sum;
}

// Of a pattern's exposures together.
struct Bracket {
  float exposure_us = 0;
  bool is_whole = false;  // frames of the same exposures in all patterns asked about
};

HWY_INLINE Bracket bracket_of(std::span<const SampleRow> rows) {
  const std::span<const ExposedRow> like = rows[0].exposures;
  if (like.empty()) return {};
  Bracket bracket{0, true};
  for (const ExposedRow& frame : like) bracket.exposure_us += frame.exposure_us;
  for (const SampleRow& row : rows) {
    bracket.is_whole = bracket.is_whole && row.exposures.size() == like.size();
    for (std::size_t k = 0; bracket.is_whole && k < like.size(); ++k)
      bracket.is_whole = row.exposures[k].exposure_us == like[k].exposure_us;
  }
  return bracket;
}

template <typename D>
HWY_INLINE Of<D> black_of(D d, std::span<const ExposedRow> exposures, std::size_t i) {
  auto black_dn = hn::LoadU(d, exposures[0].black_dn + i);
  for (const ExposedRow& frame : exposures.subspan(1))
    black_dn = hn::Add(black_dn, hn::LoadU(d, frame.black_dn + i));
  return black_dn;
}

template <typename D>
HWY_INLINE void store_pair(D d, Of<D> value, Of<D> variance, std::size_t i, const PairRow& out) {
  const auto contrast = hn::Abs(value);
  const auto best = hn::LoadU(d, out.contrast + i);
  const auto is_better = hn::Gt(contrast, best);  // NaN is not
  hn::StoreU(hn::IfThenElse(is_better, contrast, best), d, out.contrast + i);
  hn::StoreU(hn::IfThenElse(is_better, variance, hn::LoadU(d, out.contrast_variance + i)), d,
             out.contrast_variance + i);
  hn::StoreU(value, d, out.value + i);
  hn::StoreU(variance, d, out.variance + i);
}

template <typename D>
HWY_INLINE void read_pair_at(D d, const SampleRow& plain_row, const SampleRow& inverse_row,
                             const Bracket& bracket, const SampleNoise& noise, std::size_t i,
                             const PairRow& out) {
  if (bracket.is_whole) {
    const WholeSum<D> plain = sum_of(d, plain_row, i);
    const WholeSum<D> inverse = sum_of(d, inverse_row, i);
    const auto most = hn::ConvertTo(d, hn::Max(plain.most_dn, inverse.most_dn));
    if (HWY_LIKELY(hn::AllTrue(d, hn::Lt(most, hn::Set(d, noise.saturation_dn))))) {
      const auto per_us = hn::Set(d, 1 / bracket.exposure_us);
      const NoiseRange& range = noise.ranges.front();
      const auto value = hn::Mul(hn::ConvertTo(d, hn::Sub(plain.dn, inverse.dn)), per_us);
      const auto black = black_of(d, plain_row.exposures, i);
      const auto both =
          hn::NegMulAdd(hn::Set(d, 2.0F), black, hn::ConvertTo(d, hn::Add(plain.dn, inverse.dn)));
      const auto variance =
          hn::MulAdd(hn::Set(d, range.shot_dn_per_us / bracket.exposure_us),
                     hn::Max(both, hn::Zero(d)), hn::Set(d, 2 * range.read_variance));
      store_pair(d, value, variance, i, out);
      return;
    }
  }
  const auto plain = load(d, plain_row, noise.saturation_dn, i);
  const auto inverse = load(d, inverse_row, noise.saturation_dn, i);
  auto value = hn::Sub(plain, inverse);
  auto variance =
      hn::Add(variance_of(d, noise.ranges, plain), variance_of(d, noise.ranges, inverse));
  store_pair(d, value, variance, i, out);
  const auto is_lost = hn::IsNaN(value);
  if (HWY_LIKELY(hn::AllFalse(d, is_lost))) return;
  hn::StoreU(hn::Add(hn::LoadU(d, out.lost + i), hn::Sub(value, value)), d, out.lost + i);
  variance = hn::IfThenElse(is_lost, hn::Zero(d), variance);
  const auto plain_is_there = hn::And(is_lost, hn::Eq(plain, plain));
  const auto inverse_is_there = hn::And(is_lost, hn::Eq(inverse, inverse));
  value = hn::IfThenElse(inverse_is_there, hn::Set(d, kInfinity), value);
  value = hn::IfThenElse(plain_is_there, hn::Set(d, -kInfinity), value);
  hn::StoreU(value, d, out.value + i);
  hn::StoreU(variance, d, out.variance + i);
}

void read_pair_row(const SampleRow& plain, const SampleRow& inverse, const SampleNoise& noise,
                   std::size_t width, const PairRow& out) {
  const Vectors d;
  const Bracket bracket = bracket_of(std::array{plain, inverse});
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= width; i += hn::Lanes(d))
    read_pair_at(d, plain, inverse, bracket, noise, i, out);
  for (; i < width; ++i) read_pair_at(One(), plain, inverse, bracket, noise, i, out);
}

// atan2 of float's own precision.
template <typename D>
HWY_INLINE Of<D> angle_of(D d, Of<D> sine, Of<D> cosine) {
  const auto x = hn::Abs(cosine), y = hn::Abs(sine);
  const auto is_steep = hn::Gt(y, x);
  const auto ratio = hn::Div(hn::Min(x, y), hn::Max(x, y));
  constexpr float kPi = 3.14159265358979F;
  auto angle = hn::Atan(d, ratio);
  angle = hn::IfThenElse(is_steep, hn::Sub(hn::Set(d, kPi / 2), angle), angle);
  angle = hn::IfThenElse(hn::Lt(cosine, hn::Zero(d)), hn::Sub(hn::Set(d, kPi), angle), angle);
  return hn::CopySign(angle, sine);
}

// First harmonic, and the covariance of cosine and sine.
template <typename D>
struct Phasors {
  Of<D> mean, cosine, sine, cos_cos, cos_sin, sin_sin;
};

// Sums over the shifts of each sample and its variance.
template <typename D, typename Sample>
HWY_INLINE Phasors<D> sum_phasors(D d, const FamilyWeights& weights, std::size_t shift_count,
                                  const Sample& sample_and_variance) {
  const auto zero = hn::Zero(d);
  Phasors<D> sum{zero, zero, zero, zero, zero, zero};
  for (std::size_t k = 0; k < shift_count; ++k) {
    const auto [sample, variance] = sample_and_variance(k);
    const auto wc = hn::Set(d, weights.cosine[k]), ws = hn::Set(d, weights.sine[k]);
    sum.mean = hn::MulAdd(hn::Set(d, weights.mean[k]), sample, sum.mean);
    sum.cosine = hn::MulAdd(wc, sample, sum.cosine);
    sum.sine = hn::MulAdd(ws, sample, sum.sine);
    const auto cosine_variance = hn::Mul(wc, variance), sine_variance = hn::Mul(ws, variance);
    sum.cos_cos = hn::MulAdd(wc, cosine_variance, sum.cos_cos);
    sum.cos_sin = hn::MulAdd(wc, sine_variance, sum.cos_sin);
    sum.sin_sin = hn::MulAdd(ws, sine_variance, sum.sin_sin);
  }
  return sum;
}

template <typename D>
struct SampleAndVariance {
  Of<D> sample, variance;
};

template <typename D>
HWY_INLINE Phasors<D> read_phasors(D d, std::span<const SampleRow> shifts, const Bracket& bracket,
                                   const SampleNoise& noise, const FamilyWeights& weights,
                                   std::size_t i) {
  if (bracket.is_whole) {
    const hn::RebindToSigned<D> di;
    const auto black = black_of(d, shifts[0].exposures, i);
    const auto per_us = hn::Set(d, 1 / bracket.exposure_us);
    const auto shot = hn::Set(d, noise.ranges.front().shot_dn_per_us);
    const auto read = hn::Set(d, noise.ranges.front().read_variance);
    auto most_dn = hn::Zero(di);
    const Phasors<D> sum = sum_phasors(d, weights, shifts.size(), [&](std::size_t k) {
      const WholeSum<D> whole = sum_of(d, shifts[k], i);
      most_dn = hn::Max(most_dn, whole.most_dn);
      const auto sample = hn::Mul(hn::Sub(hn::ConvertTo(d, whole.dn), black), per_us);
      return SampleAndVariance<D>{sample, hn::MulAdd(shot, hn::Max(sample, hn::Zero(d)), read)};
    });
    const auto saturation = hn::Set(d, noise.saturation_dn);
    if (HWY_LIKELY(hn::AllTrue(d, hn::Lt(hn::ConvertTo(d, most_dn), saturation)))) return sum;
  }
  return sum_phasors(d, weights, shifts.size(), [&](std::size_t k) {
    const auto sample = load(d, shifts[k], noise.saturation_dn, i);
    return SampleAndVariance<D>{sample, variance_of(d, noise.ranges, sample)};
  });
}

template <typename D>
HWY_INLINE void read_phases_at(D d, std::span<const SampleRow> shifts, const Bracket& bracket,
                               const SampleNoise& noise, const FamilyWeights& weights,
                               std::size_t i, const PhaseRow& out) {
  const auto [mean, cosine, sine, cos_cos, cos_sin, sin_sin] =
      read_phasors(d, shifts, bracket, noise, weights, i);
  const auto is_lost = hn::IsNaN(cosine);
  if (HWY_UNLIKELY(!hn::AllFalse(d, is_lost)))
    hn::StoreU(hn::Add(hn::LoadU(d, out.lost + i), hn::Sub(cosine, cosine)), d, out.lost + i);
  const auto square = hn::MulAdd(cosine, cosine, hn::Mul(sine, sine));
  const auto amplitude = hn::Sqrt(square);
  const auto c = hn::Div(cosine, amplitude), s = hn::Div(sine, amplitude);
  const auto cc = hn::Mul(c, c), ss = hn::Mul(s, s);
  const auto cross = hn::Mul(hn::Mul(hn::Set(d, 2.0F), hn::Mul(c, s)), cos_sin);
  const auto along = hn::Add(hn::MulAdd(cc, cos_cos, cross), hn::Mul(ss, sin_sin));
  const auto across = hn::Sub(hn::MulAdd(ss, cos_cos, hn::Mul(cc, sin_sin)), cross);
  const auto scale = hn::Set(d, weights.modulation_scale);
  const auto across_sd = hn::Sqrt(hn::Max(across, hn::Zero(d)));
  const auto has_phase = hn::Gt(amplitude, hn::Mul(hn::Set(d, kMinAmplitudeSd), across_sd));
  const auto px_per_rad = hn::Set(d, weights.px_per_rad);
  const auto noise_px = hn::Mul(px_per_rad, hn::Div(across_sd, amplitude));
  const auto aliasing = hn::Set(d, weights.aliasing_px * weights.aliasing_px);
  const auto sd_px = hn::Sqrt(hn::MulAdd(noise_px, noise_px, aliasing));
  const auto position_px =
      hn::MulAdd(px_per_rad, angle_of(d, sine, cosine), hn::Set(d, weights.centre_px));
  hn::StoreU(mean, d, out.mean + i);
  hn::StoreU(hn::Mul(amplitude, scale), d, out.modulation + i);
  hn::StoreU(hn::Mul(hn::Sqrt(hn::Max(along, hn::Zero(d))), scale), d, out.modulation_sd + i);
  hn::StoreU(hn::IfThenElse(has_phase, sd_px, hn::Set(d, kInfinity)), d, out.sd_px + i);
  hn::StoreU(hn::IfThenElse(has_phase, position_px, hn::Set(d, kNaN)), d, out.position_px + i);
}

void read_phases_row(std::span<const SampleRow> shifts, const SampleNoise& noise,
                     const FamilyWeights& weights, std::size_t begin, std::size_t end,
                     const PhaseRow& out) {
  const Vectors d;
  const Bracket bracket = bracket_of(shifts);
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d))
    read_phases_at(d, shifts, bracket, noise, weights, i, out);
  for (; i < end; ++i) read_phases_at(One(), shifts, bracket, noise, weights, i, out);
}

template <typename D>
HWY_INLINE void sum_shifts_at(D d, std::span<const SampleRow> shifts, float saturation_dn,
                              std::size_t i, const WeightedSums& sums) {
  // Apart, because vectors of some processors make no array.
  auto a = hn::Zero(d), b = a, c = a, e = a, f = a, g = a;
  const auto& weights = sums.weights;
  for (std::size_t k = 0; k < shifts.size(); ++k) {
    const auto sample = load(d, shifts[k], saturation_dn, i);
    a = hn::MulAdd(hn::Set(d, weights[0][k]), sample, a);
    b = hn::MulAdd(hn::Set(d, weights[1][k]), sample, b);
    c = hn::MulAdd(hn::Set(d, weights[2][k]), sample, c);
    e = hn::MulAdd(hn::Set(d, weights[3][k]), sample, e);
    f = hn::MulAdd(hn::Set(d, weights[4][k]), sample, f);
    g = hn::MulAdd(hn::Set(d, weights[5][k]), sample, g);
  }
  hn::StoreU(a, d, sums.out[0] + i);
  hn::StoreU(b, d, sums.out[1] + i);
  hn::StoreU(c, d, sums.out[2] + i);
  hn::StoreU(e, d, sums.out[3] + i);
  hn::StoreU(f, d, sums.out[4] + i);
  hn::StoreU(g, d, sums.out[5] + i);
}

void sum_shifts_row(std::span<const SampleRow> shifts, float saturation_dn, std::size_t begin,
                    std::size_t end, const WeightedSums& sums) {
  const Vectors d;
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d))
    sum_shifts_at(d, shifts, saturation_dn, i, sums);
  for (; i < end; ++i) sum_shifts_at(One(), shifts, saturation_dn, i, sums);
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(read_pair_row);
HWY_EXPORT(read_phases_row);
HWY_EXPORT(sum_shifts_row);

void read_pair(const SampleRow& plain, const SampleRow& inverse, const SampleNoise& noise,
               std::size_t width, const PairRow& out) {
  HWY_DYNAMIC_DISPATCH(read_pair_row)(plain, inverse, noise, width, out);
}

void read_phases(std::span<const SampleRow> shifts, const SampleNoise& noise,
                 const FamilyWeights& weights, std::size_t begin, std::size_t end,
                 const PhaseRow& out) {
  HWY_DYNAMIC_DISPATCH(read_phases_row)(shifts, noise, weights, begin, end, out);
}

void sum_shifts(std::span<const SampleRow> shifts, float saturation_dn, std::size_t begin,
                std::size_t end, const WeightedSums& sums) {
  HWY_DYNAMIC_DISPATCH(sum_shifts_row)(shifts, saturation_dn, begin, end, sums);
}

}  // namespace estimation
#endif
