// A vector of pixels' model: noise, harmonics from the table, and the samples made of them.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_MODEL_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_MODEL_INL_H
#undef SSRIG_BATCH_MODEL_INL_H
#else
#define SSRIG_BATCH_MODEL_INL_H
#endif

#include <hwy/contrib/math/math-inl.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>

#include "estimation/profile/batch_kernel.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using DI = hn::RebindToSigned<D>;
using DU = hn::RebindToUnsigned<D>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;
constexpr std::size_t kLanes = hn::MaxLanes(D());

// As in pixel_model.cpp.
constexpr float kLeastSd = 1e-6F;
constexpr float kTruncation = 30;

struct Complex {
  V re, im;
};

HWY_INLINE Complex times(Complex a, Complex b) {
  return {hn::MulSub(a.re, b.re, hn::Mul(a.im, b.im)), hn::MulAdd(a.re, b.im, hn::Mul(a.im, b.re))};
}

HWY_INLINE Complex times_conjugate(Complex a, Complex b) {
  return {hn::MulAdd(a.re, b.re, hn::Mul(a.im, b.im)), hn::MulSub(a.im, b.re, hn::Mul(a.re, b.im))};
}

// exp(2 pi i turns).
HWY_INLINE Complex unit_at(V turns) {
  const D d;
  const V angle = hn::Mul(hn::Sub(turns, hn::Round(turns)),
                          hn::Set(d, static_cast<float>(2 * std::numbers::pi)));
  return {hn::Cos(d, angle), hn::Sin(d, angle)};
}

// Its inverse, -1/2 to 1/2.
HWY_INLINE V turn_of(Complex unit) {
  const D d;
  const V width = hn::Abs(unit.re), height = hn::Abs(unit.im);
  const V small = hn::Min(width, height),
          large = hn::Max(hn::Max(width, height), hn::Set(d, 1e-20F));
  const V octant = hn::Mul(hn::Atan(d, hn::Div(small, large)),
                           hn::Set(d, static_cast<float>(0.5 / std::numbers::pi)));
  const V quadrant =
      hn::IfThenElse(hn::Gt(height, width), hn::Sub(hn::Set(d, 0.25F), octant), octant);
  const V half =
      hn::IfThenElse(hn::Lt(unit.re, hn::Zero(d)), hn::Sub(hn::Set(d, 0.5F), quadrant), quadrant);
  return hn::CopySignToAbs(half, unit.im);
}

// f_n of the optics and the model's directions; 0 beyond those that the batch has.
HWY_INLINE Complex factor_of(const PixelBatch& batch, std::size_t n, std::size_t first) {
  const D d;
  if (batch.factor_re.empty()) return {hn::Set(d, 1.0F), hn::Zero(d)};
  if (n >= static_cast<std::size_t>(batch.factor_count)) return {hn::Zero(d), hn::Zero(d)};
  return {hn::LoadU(d, batch.factor_re.data() + n * batch.stride + first),
          hn::LoadU(d, batch.factor_im.data() + n * batch.stride + first)};
}

// The variance of a sample's reflectance factor where the model expects this much of it, as
// variance_at has it.
struct NoiseOfPixel {
  V read[BatchPlan::kMostNoise], shot[BatchPlan::kMostNoise];
  V per_width[BatchPlan::kMostNoise],
      middle[BatchPlan::kMostNoise];  // share = r per_width - middle
  std::size_t count;

  HWY_INLINE void load(const BatchPlan& plan, V full, V per_full) {
    const D d;
    count = plan.noise_count;
    for (std::size_t i = 0; i < count; ++i) {
      read[i] = hn::Mul(hn::Set(d, plan.noise[i].read_variance), hn::Mul(per_full, per_full));
      shot[i] = hn::Mul(hn::Set(d, plan.noise[i].shot_dn_per_us), per_full);
      per_width[i] = hn::Mul(hn::Set(d, plan.noise[i].per_width), full);
      middle[i] = hn::Set(d, plan.noise[i].middle);
    }
  }

  HWY_INLINE V variance(V reflectance) const {
    const D d;
    const V light = hn::Max(reflectance, hn::Zero(d)), one = hn::Set(d, 1.0F);
    V variance = hn::MulAdd(shot[count - 1], light, read[count - 1]);
    for (std::size_t i = count - 1; i-- > 0;) {
      const V share = hn::MulSub(reflectance, per_width[i], middle[i]);
      const V own = hn::MulAdd(shot[i], light, read[i]);
      variance = hn::MulAdd(hn::Min(hn::Max(share, hn::Zero(d)), one), hn::Sub(variance, own), own);
    }
    return hn::Max(variance, hn::Set(d, kLeastSd * kLeastSd));
  }
};

// A sample as the model has it.
struct Sample {
  V value, by_logit, by_log, by_phase;
};

// The harmonics of a vector of pixels at one point of their search.
class Harmonics {
 public:
  // False in lanes whose table lacks harmonics that matter. Harmonics of lanes that are not wanted
  // are zero.
  HWY_INLINE M evaluate(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                        std::size_t first, V logit, V log, V position_px, V mean, V tolerance,
                        M wanted) {
    const D d;
    // Harmonics without a factor are none.
    const bool is_cut_off = plan.is_cut_off || (!batch.factor_re.empty() &&
                                                batch.factor_count - 1 <= plan.harmonic_count);
    const int blocks = load_nodes(plan, is_cut_off, logit, log, tolerance, wanted);
    const float period_px = static_cast<float>(plan.shape.period_px);
    const Complex turn = unit_at(hn::Mul(position_px, hn::Set(d, 1 / period_px)));
    count_ = std::min(static_cast<std::size_t>(4 * blocks),
                      static_cast<std::size_t>(plan.harmonic_count));
    bin_count_ = std::min(count_ + 1, basis.bin_stride);
    per_period_ = 1 / period_px;
    clear_bins(count_, basis);
    bins_[0][kValueRe] = mean;
    Complex unit = turn;
    for (std::size_t n = 1; n <= count_; ++n) {
      add_harmonic(batch, basis, first, n, unit,
                   static_cast<float>(2 * std::numbers::pi) / period_px);
      unit = times(unit, turn);
    }
    return hn::RebindMask(d, hn::Ne(hn::Load(DI(), suffices_), hn::Zero(DI())));
  }

  // Calls add(j, sample) for each of the sweep's samples.
  template <bool kQuartered, typename Add>
  HWY_INLINE void for_samples(const SweepBasis& basis, const PixelBatch& batch, std::size_t first,
                              const Add& add) const {
    if constexpr (kQuartered)
      for_quartered(basis, add);
    else if (batch.offset_px.size() > basis.sample_count)
      for_own_offsets(basis, batch, first, add);
    else
      for_shared_shifts(basis, add);
  }

 private:
  // Parts of a bin: real and imaginary part of the value and its derivatives.
  enum Part { kValueRe, kValueIm, kLogitRe, kLogitIm, kLogRe, kLogIm, kPhaseRe, kPhaseIm, kParts };
  using Bin = V[kParts];

  // Taylor terms of each lane's node, evaluated there: [value, d/dt, d/dlambda][block], harmonic
  // by harmonic, four at a time, such that a vector holds the same four of lanes i, 4 + i, 8 + i
  // ...
  static constexpr std::size_t kRowFloats = kLanes < 4 ? 4 : kLanes;
  static constexpr std::size_t kMostBlocks = kMostBatchHarmonics / 4;

  HWY_INLINE int load_nodes(const BatchPlan& plan, bool is_cut_off, V logit, V log, V tolerance,
                            M wanted) {
    const D d;
    const HarmonicTable& table = *plan.table;
    const auto place = [&](V at, double least, double step, int count) HWY_ATTR {
      const V index = hn::Round(hn::Mul(hn::Sub(at, hn::Set(d, static_cast<float>(least))),
                                        hn::Set(d, static_cast<float>(1 / step))));
      return hn::Min(hn::Max(index, hn::Zero(d)), hn::Set(d, static_cast<float>(count - 1)));
    };
    const ShapePoint& least = table.range().least;
    const V row = place(logit, least.logit_reflectance, table.logit_step(), table.rows());
    const V col = place(log, least.log_translucency_px, table.log_step(), table.cols());
    const auto rest = [&](V at, V index, double first, double step) HWY_ATTR {
      return hn::NegMulAdd(index, hn::Set(d, static_cast<float>(step)),
                           hn::Sub(at, hn::Set(d, static_cast<float>(first))));
    };
    HWY_ALIGN float dt[kLanes], dl[kLanes], least_size[kLanes];
    HWY_ALIGN std::int32_t rows[kLanes], cols[kLanes];
    hn::Store(rest(logit, row, least.logit_reflectance, table.logit_step()), d, dt);
    hn::Store(rest(log, col, least.log_translucency_px, table.log_step()), d, dl);
    hn::Store(hn::IfThenElse(wanted, tolerance, hn::Set(d, 1e30F)), d, least_size);
    hn::Store(hn::ConvertTo(DI(), row), DI(), rows);
    hn::Store(hn::ConvertTo(DI(), col), DI(), cols);
    int used[kLanes];
    int most = 1;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      used[lane] = load_node(plan, is_cut_off, table.node(rows[lane], cols[lane]).data(), dt[lane],
                             dl[lane], least_size[lane], lane);
      most = std::max(most, used[lane]);
    }
    const hn::CappedTag<float, 4> d4;
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      for (int block = used[lane]; block < most; ++block)
        for (std::size_t value = 0; value < 3; ++value)
          for (std::size_t i = 0; i < 4; i += hn::Lanes(d4))
            hn::Store(hn::Zero(d4), d4, slot(value, static_cast<std::size_t>(block), lane) + i);
    return most;
  }

  HWY_INLINE float* slot(std::size_t value, std::size_t block, std::size_t lane) {
    return nodes_[value][block][lane % 4] + 4 * (lane / 4);
  }

  // Returns how many blocks of four rise above `least_size`, at least one.
  HWY_INLINE int load_node(const BatchPlan& plan, bool is_cut_off, const float* HWY_RESTRICT node,
                           float dt, float dl, float least_size, std::size_t lane) {
    const hn::CappedTag<float, 4> d4;
    const std::size_t stride = plan.table->harmonic_stride();
    const int most = (plan.harmonic_count + 3) / 4;
    const auto vt = hn::Set(d4, dt), vl = hn::Set(d4, dl);
    const auto floor = hn::Set(d4, least_size), cut_floor = hn::Set(d4, kTruncation * least_size);
    bool suffices = true;
    int block = 0;
    for (; block < most; ++block) {
      bool is_small = true;
      for (std::size_t i = 0; i < 4; i += hn::Lanes(d4)) {
        const float* const at = node + 4 * static_cast<std::size_t>(block) + i;
        const auto a = hn::LoadU(d4, at), t = hn::LoadU(d4, at + stride),
                   l = hn::LoadU(d4, at + 2 * stride), tt = hn::LoadU(d4, at + 3 * stride),
                   tl = hn::LoadU(d4, at + 4 * stride), ll = hn::LoadU(d4, at + 5 * stride);
        const auto size = hn::Max(hn::Abs(a), hn::Max(hn::Abs(t), hn::Abs(l)));
        is_small = is_small && hn::AllTrue(d4, hn::Lt(size, floor));
        suffices = block + 1 < most || is_cut_off || hn::AllTrue(d4, hn::Lt(size, cut_floor));
        const auto ttt = hn::Mul(vt, tt), lll = hn::Mul(vl, ll);
        const auto by_t = hn::MulAdd(vl, tl, hn::Add(t, ttt));  // half of tt's share to come
        const auto value = hn::MulAdd(vl, hn::Add(l, lll), hn::MulAdd(vt, by_t, a));
        const auto by_l = hn::MulAdd(vt, tl, hn::Add(l, hn::Add(lll, lll)));
        const auto b = static_cast<std::size_t>(block);
        hn::Store(value, d4, slot(0, b, lane) + i);
        hn::Store(hn::Add(by_t, ttt), d4, slot(1, b, lane) + i);
        hn::Store(by_l, d4, slot(2, b, lane) + i);
      }
      if (is_small && block > 0) break;
    }
    suffices_[lane] = suffices ? 1 : 0;
    return block;
  }

  // Harmonic n = 4 block + i + 1 of all lanes.
  HWY_INLINE V node_value(std::size_t value, std::size_t n) const {
    const D d;
    const std::size_t block = (n - 1) / 4, i = (n - 1) % 4;
#if HWY_TARGET == HWY_SCALAR
    return hn::Load(d, nodes_[value][block][0] + i);
#else
    const hn::Repartition<double, D> wide;
    const auto load = [&](std::size_t row)
                          HWY_ATTR { return hn::Load(d, nodes_[value][block][row]); };
    const bool is_upper = i >= 2;
    const V pair01 = is_upper ? hn::InterleaveUpper(d, load(0), load(1))
                              : hn::InterleaveLower(d, load(0), load(1));
    const V pair23 = is_upper ? hn::InterleaveUpper(d, load(2), load(3))
                              : hn::InterleaveLower(d, load(2), load(3));
    const auto a = hn::BitCast(wide, pair01), b = hn::BitCast(wide, pair23);
    return hn::BitCast(
        d, i % 2 == 0 ? hn::InterleaveLower(wide, a, b) : hn::InterleaveUpper(wide, a, b));
#endif
  }

  HWY_INLINE void clear_bins(std::size_t harmonic_count, const SweepBasis& basis) {
    const std::size_t count = std::min(harmonic_count + 1, basis.bin_stride);
    for (std::size_t bin = 0; bin < count; ++bin)
      for (V& part : bins_[bin]) part = hn::Zero(D());
  }

  HWY_INLINE void add_harmonic(const PixelBatch& batch, const SweepBasis& basis, std::size_t first,
                               std::size_t n, Complex unit, float wave_per_px) {
    const D d;
    const V a = node_value(0, n), by_logit = node_value(1, n), by_log = node_value(2, n);
    Complex g = batch.factor_re.empty() ? unit : times(unit, factor_of(batch, n, first));
    g = {hn::Add(g.re, g.re), hn::Add(g.im, g.im)};
    if (basis.is_mirrored[n]) g.im = hn::Neg(g.im);
    V* const bin = bins_[basis.bin_of[n]];
    bin[kValueRe] = hn::MulAdd(a, g.re, bin[kValueRe]);
    bin[kValueIm] = hn::MulAdd(a, g.im, bin[kValueIm]);
    bin[kLogitRe] = hn::MulAdd(by_logit, g.re, bin[kLogitRe]);
    bin[kLogitIm] = hn::MulAdd(by_logit, g.im, bin[kLogitIm]);
    bin[kLogRe] = hn::MulAdd(by_log, g.re, bin[kLogRe]);
    bin[kLogIm] = hn::MulAdd(by_log, g.im, bin[kLogIm]);
    const float sign = basis.is_mirrored[n] ? -1.0F : 1.0F;
    const V turned = hn::Mul(a, hn::Set(d, sign * wave_per_px * static_cast<float>(n)));
    bin[kPhaseRe] = hn::NegMulAdd(turned, g.im, bin[kPhaseRe]);
    bin[kPhaseIm] = hn::MulAdd(turned, g.re, bin[kPhaseIm]);
  }

  template <typename Add>
  HWY_INLINE void for_quartered(const SweepBasis& basis, const Add& add) const {
    const std::size_t quarter = basis.sample_count / 4;
    for (std::size_t j = 0; j <= quarter; ++j) {
      const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
      Sums4 even_cos, even_sin, odd_cos, odd_sin;
      for (std::size_t f = 0; f < 4; ++f) {
        even_cos[f] = bins_[0][2 * f];
        even_sin[f] = odd_cos[f] = odd_sin[f] = hn::Zero(D());
      }
      for (std::size_t bin = 1; bin < bin_count_; bin += 2) add_bin(waves, bin, odd_cos, odd_sin);
      for (std::size_t bin = 2; bin < bin_count_; bin += 2) add_bin(waves, bin, even_cos, even_sin);
      Sums4 near, far, near_sin, far_sin;
      for (std::size_t f = 0; f < 4; ++f) {
        near[f] = hn::Add(even_cos[f], odd_cos[f]);
        far[f] = hn::Sub(even_cos[f], odd_cos[f]);
        near_sin[f] = hn::Add(even_sin[f], odd_sin[f]);
        far_sin[f] = hn::Sub(even_sin[f], odd_sin[f]);
      }
      const auto plus = [](const Sums4& a, const Sums4& b) HWY_ATTR {
        return Sample{hn::Add(a[0], b[0]), hn::Add(a[1], b[1]), hn::Add(a[2], b[2]),
                      hn::Add(a[3], b[3])};
      };
      const auto minus = [](const Sums4& a, const Sums4& b) HWY_ATTR {
        return Sample{hn::Sub(a[0], b[0]), hn::Sub(a[1], b[1]), hn::Sub(a[2], b[2]),
                      hn::Sub(a[3], b[3])};
      };
      add(j, plus(near, near_sin));
      if (j < quarter) add(2 * quarter + j, plus(far, far_sin));
      if (j == 0) continue;
      add(4 * quarter - j, minus(near, near_sin));
      if (j < quarter) add(2 * quarter - j, minus(far, far_sin));
    }
  }

  template <typename Add>
  HWY_INLINE void for_shared_shifts(const SweepBasis& basis, const Add& add) const {
    for (std::size_t j = 0; j < basis.sample_count; ++j) {
      const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
      Sums4 cosines, sines;
      for (std::size_t f = 0; f < 4; ++f) cosines[f] = bins_[0][2 * f], sines[f] = hn::Zero(D());
      for (std::size_t bin = 1; bin < bin_count_; ++bin) add_bin(waves, bin, cosines, sines);
      add(j, Sample{hn::Add(cosines[0], sines[0]), hn::Add(cosines[1], sines[1]),
                    hn::Add(cosines[2], sines[2]), hn::Add(cosines[3], sines[3])});
    }
  }

  // Each pixel's shifts differ: so do its waves, from the nominal ones turned by the offset.
  template <typename Add>
  HWY_INLINE void for_own_offsets(const SweepBasis& basis, const PixelBatch& batch,
                                  std::size_t first, const Add& add) const {
    const D d;
    const V per_period = hn::Set(d, per_period_);
    for (std::size_t j = 0; j < basis.sample_count; ++j) {
      const auto row = static_cast<std::size_t>(basis.row_of[j]);
      const V offset = hn::LoadU(d, batch.offset_px.data() + row * batch.stride + first);
      const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
      const Complex nominal{hn::Set(d, waves[2]), hn::Set(d, waves[3])};
      const Complex turn = times(nominal, unit_at(hn::Mul(offset, per_period)));
      Complex unit = turn;
      Sums4 cosines, sines;
      for (std::size_t f = 0; f < 4; ++f) cosines[f] = bins_[0][2 * f], sines[f] = hn::Zero(d);
      for (std::size_t bin = 1; bin < bin_count_; ++bin) {
        for (std::size_t f = 0; f < 4; ++f) {
          cosines[f] = hn::MulAdd(bins_[bin][2 * f], unit.re, cosines[f]);
          sines[f] = hn::MulAdd(bins_[bin][2 * f + 1], unit.im, sines[f]);
        }
        unit = times(unit, turn);
      }
      add(j, Sample{hn::Add(cosines[0], sines[0]), hn::Add(cosines[1], sines[1]),
                    hn::Add(cosines[2], sines[2]), hn::Add(cosines[3], sines[3])});
    }
  }

  using Sums4 = V[4];

  HWY_INLINE void add_bin(const float* waves, std::size_t bin, Sums4& cosines, Sums4& sines) const {
    const V cosine = hn::Set(D(), waves[2 * bin]), sine = hn::Set(D(), waves[2 * bin + 1]);
    for (std::size_t f = 0; f < 4; ++f) {
      cosines[f] = hn::MulAdd(bins_[bin][2 * f], cosine, cosines[f]);
      sines[f] = hn::MulAdd(bins_[bin][2 * f + 1], sine, sines[f]);
    }
  }

  HWY_ALIGN float nodes_[3][kMostBlocks][4][kRowFloats];
  HWY_ALIGN std::int32_t suffices_[kLanes];
  Bin bins_[kMostBatchHarmonics + 1];
  std::size_t count_ = 0, bin_count_ = 0;
  float per_period_ = 0;
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
