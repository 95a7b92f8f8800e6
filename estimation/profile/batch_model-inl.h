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
      read[i] = hn::MulAdd(hn::Set(d, plan.noise[i].read_variance), hn::Mul(per_full, per_full),
                           hn::Set(d, kLeastSd * kLeastSd));
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
    return variance;
  }
};

// A sample as the model has it.
struct Sample {
  V value, by_logit, by_log, by_phase;
};

// The harmonics of a vector of pixels at one point of their search.
class Harmonics {
 public:
  // For the pixels to come: which harmonics are left out, and which must not be missing, by their
  // height in a sample.
  HWY_INLINE void set_tolerance(const BatchPlan& plan, const PixelBatch& batch, std::size_t first,
                                V tolerance, V truncation) {
    const D d;
    for (std::size_t block = 0; block < plan.block_count; ++block) {
      V power = hn::Set(d, 1e-20F);
      for (std::size_t n = 4 * block + 1; n <= 4 * block + 4; ++n) {
        const Complex f = factor_of(batch, n, first);
        power = hn::Max(power, hn::MulAdd(f.re, f.re, hn::Mul(f.im, f.im)));
      }
      const V per_factor = hn::Div(hn::Set(d, 0.5F), hn::Sqrt(power));  // G = 2 a f
      hn::Store(hn::Mul(tolerance, per_factor), d, least_size_[block]);
      if (block + 1 == plan.block_count)
        hn::Store(hn::Mul(truncation, per_factor), d, greatest_last_);
    }
    // Harmonics without a factor are none.
    is_cut_off_ = !batch.factor_re.empty() && batch.factor_count - 1 <= plan.harmonic_count;
  }

  // False in lanes whose table lacks harmonics that matter. Lanes that are not wanted may hold
  // anything finite. `coarseness` multiplies the tolerance.
  HWY_INLINE M evaluate(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                        std::size_t first, V logit, V log, V position_px, V mean, M wanted,
                        float coarseness) {
    const D d;
    const std::size_t blocks = block_count_ = load_nodes(plan, logit, log, wanted, coarseness);
    const float period_px = static_cast<float>(plan.shape.period_px);
    per_period_ = 1 / period_px;
    const Complex turn = unit_at(hn::Mul(position_px, hn::Set(d, per_period_)));
    const std::size_t count = harmonic_count_ =
        std::min(4 * blocks, static_cast<std::size_t>(plan.harmonic_count));
    bin_count_ = std::min(count + 1, basis.bin_stride);
    for (std::size_t part = 0; part < kParts; ++part) bins_[0][part] = hn::Zero(d);
    bins_[0][kValueRe] = mean;
    Complex unit = turn;
    for (std::size_t block = 0; 4 * block < count; ++block) {
      V values[3][4];  // [value, d/dt, d/dlambda][harmonic]
      for (std::size_t value = 0; value < 3; ++value)
        harmonics_of_block(value, block, values[value]);
      for (std::size_t i = 0; i < 4 && 4 * block + i < count; ++i) {
        set_harmonic(batch, basis, first, 4 * block + i + 1, unit, values[0][i], values[1][i],
                     values[2][i]);
        unit = times(unit, turn);
      }
    }
    return hn::RebindMask(d, hn::Ne(hn::Load(DI(), suffices_), hn::Zero(DI())));
  }

  // Puts the samples' expected shift in the place of their value: 1/2 tr(H C) for second
  // derivatives H at the point evaluated last and a covariance C of (t, ln l, phase) there.
  //   mean  what the mean shifts
  HWY_INLINE void set_expected_shift(const PixelBatch& batch, const SweepBasis& basis,
                                     std::size_t first, V position_px, V mean, V tt, V tl, V ll,
                                     V tp, V lp, V pp) {
    const D d;
    load_curvature(tt, tl, ll);
    const Complex turn = unit_at(hn::Mul(position_px, hn::Set(d, per_period_)));
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period_;
    const V half_pp = hn::Mul(pp, hn::Set(d, 0.5F * wave_per_px * wave_per_px));
    const V turn_t = hn::Mul(tp, hn::Set(d, wave_per_px)),
            turn_l = hn::Mul(lp, hn::Set(d, wave_per_px));
    bins_[0][kValueRe] = mean;
    Complex unit = turn;
    for (std::size_t block = 0; 4 * block < harmonic_count_; ++block) {
      V values[4][4];  // [value, d/dt, d/dlambda, 1/2 tr(H C)][harmonic]
      for (std::size_t value = 0; value < 4; ++value)
        harmonics_of_block(value, block, values[value]);
      for (std::size_t i = 0; i < 4 && 4 * block + i < harmonic_count_; ++i) {
        const std::size_t n = 4 * block + i + 1;
        const V order = hn::Set(d, static_cast<float>(n));
        const Complex shift{
            hn::NegMulAdd(hn::Mul(hn::Mul(order, order), half_pp), values[0][i], values[3][i]),
            hn::Mul(order, hn::MulAdd(turn_t, values[1][i], hn::Mul(turn_l, values[2][i])))};
        const Complex g = times(shift, doubled_factor(batch, n, unit, first));
        const V parts[2] = {g.re, g.im};
        add_to_bin(basis, n, parts);
        unit = times(unit, turn);
      }
    }
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
  using Sums4 = V[4];  // of a sample's value and derivatives

  // Taylor terms of each lane's node, evaluated there: [value, d/dt, d/dlambda][block], harmonic
  // by harmonic, four at a time, such that a vector holds the same four of lanes i, 4 + i, 8 + i
  // ...
  static constexpr std::size_t kRowFloats = kLanes < 4 ? 4 : kLanes;
  static constexpr std::size_t kMostBlocks = kMostBatchHarmonics / 4 + 1;

  // Returns the number of blocks that some lane has.
  HWY_INLINE std::size_t load_nodes(const BatchPlan& plan, V logit, V log, M wanted,
                                    float coarseness) {
    const D d;
    const DI di;
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
    HWY_ALIGN float dt[kLanes], dl[kLanes];
    HWY_ALIGN std::int32_t rows[kLanes], cols[kLanes], is_wanted[kLanes];
    hn::Store(rest(logit, row, least.logit_reflectance, table.logit_step()), d, dt);
    hn::Store(rest(log, col, least.log_translucency_px, table.log_step()), d, dl);
    hn::Store(hn::ConvertTo(di, row), di, rows);
    hn::Store(hn::ConvertTo(di, col), di, cols);
    hn::Store(hn::BitCast(di, hn::VecFromMask(d, wanted)), di, is_wanted);
    const float* const nodes = table.node(0, 0).data();
    const std::size_t stride = table.harmonic_stride();
    curvature_stride_ = stride;
    std::size_t most = 1;
    const std::size_t last = plan.block_count - 1;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const auto node = static_cast<std::size_t>(rows[lane] * table.cols() + cols[lane]);
      const float* const sizes = plan.sizes + node * plan.block_count;
      std::size_t count = is_wanted[lane] != 0 ? plan.block_count : 1;
      while (count > 1 && sizes[count - 1] < coarseness * least_size_[count - 1][lane]) --count;
      suffices_[lane] = is_cut_off_ || sizes[last] <= greatest_last_[lane] ? 1 : 0;
      node_of_[lane] = nodes + node * HarmonicTable::kTerms * stride;
      load_node(node_of_[lane], stride, dt[lane], dl[lane], count, lane);
      used_[lane] = count;
      most = std::max(most, count);
    }
    for (std::size_t value = 0; value < 3; ++value) clear_unused(value, most);
    return most;
  }

  HWY_INLINE void clear_unused(std::size_t value, std::size_t most) {
    const hn::CappedTag<float, 4> d4;
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      for (std::size_t block = used_[lane]; block < most; ++block)
        for (std::size_t i = 0; i < 4; i += hn::Lanes(d4))
          hn::Store(hn::Zero(d4), d4, slot(value, block, lane) + i);
  }

  // The nodes' second derivatives times this covariance, halved, as a fourth value.
  HWY_INLINE void load_curvature(V tt, V tl, V ll) {
    const hn::CappedTag<float, 4> d4;
    HWY_ALIGN float c_tt[kLanes], c_tl[kLanes], c_ll[kLanes];
    hn::Store(tt, D(), c_tt);
    hn::Store(tl, D(), c_tl);
    hn::Store(ll, D(), c_ll);
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const float* const terms = node_of_[lane] + 3 * curvature_stride_;
      const auto vtt = hn::Set(d4, c_tt[lane]), vtl = hn::Set(d4, c_tl[lane]),
                 vll = hn::Set(d4, c_ll[lane]);
      for (std::size_t n = 0; n < 4 * used_[lane]; n += hn::Lanes(d4)) {
        const float* const at = terms + n;
        const auto shift =
            hn::MulAdd(vtt, hn::LoadU(d4, at),
                       hn::MulAdd(vtl, hn::LoadU(d4, at + curvature_stride_),
                                  hn::Mul(vll, hn::LoadU(d4, at + 2 * curvature_stride_))));
        hn::Store(shift, d4, slot(3, n / 4, lane) + n % 4);
      }
    }
    clear_unused(3, block_count_);
  }

  HWY_INLINE float* slot(std::size_t value, std::size_t block, std::size_t lane) {
    return nodes_[value][block][lane % 4] + 4 * (lane / 4);
  }

  // Two blocks at a time where vectors are long enough: the table's rows are padded to eight, and a
  // block too many is not used.
  HWY_INLINE void load_node(const float* HWY_RESTRICT node, std::size_t stride, float dt, float dl,
                            std::size_t block_count, std::size_t lane) {
    const hn::CappedTag<float, 8> d8;
    [[maybe_unused]] const hn::CappedTag<float, 4> d4;
    const auto vt = hn::Set(d8, dt), vl = hn::Set(d8, dl);
    const auto put = [&](std::size_t value, std::size_t n, auto terms) HWY_ATTR {
      float* const at = slot(value, n / 4, lane) + n % 4;
#if HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3
      hn::Store(hn::LowerHalf(terms), d4, at);
      hn::Store(hn::UpperHalf(d4, terms), d4, slot(value, n / 4 + 1, lane));
#else
      hn::Store(terms, d8, at);
#endif
    };
    for (std::size_t n = 0; n < 4 * block_count; n += hn::Lanes(d8)) {
      const float* const at = node + n;
      const auto a = hn::LoadU(d8, at), t = hn::LoadU(d8, at + stride),
                 l = hn::LoadU(d8, at + 2 * stride), tt = hn::LoadU(d8, at + 3 * stride),
                 tl = hn::LoadU(d8, at + 4 * stride), ll = hn::LoadU(d8, at + 5 * stride);
      const auto half_t = hn::MulAdd(vl, tl, hn::MulAdd(vt, tt, t));  // lacks tt once more
      const auto half_l = hn::MulAdd(vl, ll, l);
      put(0, n, hn::MulAdd(vl, half_l, hn::MulAdd(vt, half_t, a)));
      put(1, n, hn::MulAdd(vt, tt, half_t));
      put(2, n, hn::MulAdd(vt, tl, hn::MulAdd(vl, ll, half_l)));
    }
  }

  // The block's four harmonics, each of all lanes.
  HWY_INLINE void harmonics_of_block(std::size_t value, std::size_t block, V (&out)[4]) const {
    const D d;
    const auto& rows = nodes_[value][block];
#if HWY_TARGET == HWY_SCALAR
    for (std::size_t i = 0; i < 4; ++i) out[i] = hn::Load(d, rows[0] + i);
#else
    // Four by four, in every 128 bits.
    const hn::Repartition<double, D> wide;
    const V row0 = hn::Load(d, rows[0]), row1 = hn::Load(d, rows[1]), row2 = hn::Load(d, rows[2]),
            row3 = hn::Load(d, rows[3]);
    const auto low01 = hn::BitCast(wide, hn::InterleaveLower(d, row0, row1)),
               low23 = hn::BitCast(wide, hn::InterleaveLower(d, row2, row3)),
               high01 = hn::BitCast(wide, hn::InterleaveUpper(d, row0, row1)),
               high23 = hn::BitCast(wide, hn::InterleaveUpper(d, row2, row3));
    out[0] = hn::BitCast(d, hn::InterleaveLower(wide, low01, low23));
    out[1] = hn::BitCast(d, hn::InterleaveUpper(wide, low01, low23));
    out[2] = hn::BitCast(d, hn::InterleaveLower(wide, high01, high23));
    out[3] = hn::BitCast(d, hn::InterleaveUpper(wide, high01, high23));
#endif
  }

  // Harmonics come in rising order: the first of a bin sets it, those folded into it add.
  HWY_INLINE void set_harmonic(const PixelBatch& batch, const SweepBasis& basis, std::size_t first,
                               std::size_t n, Complex unit, V a, V by_logit, V by_log) {
    const D d;
    const Complex g = doubled_factor(batch, n, unit, first);
    const float wave_per_px = static_cast<float>(2 * std::numbers::pi) * per_period_;
    const V turned = hn::Mul(a, hn::Set(d, wave_per_px * static_cast<float>(n)));
    const V parts[kParts] = {hn::Mul(a, g.re),
                             hn::Mul(a, g.im),
                             hn::Mul(by_logit, g.re),
                             hn::Mul(by_logit, g.im),
                             hn::Mul(by_log, g.re),
                             hn::Mul(by_log, g.im),
                             hn::Neg(hn::Mul(turned, g.im)),
                             hn::Mul(turned, g.re)};
    add_to_bin(basis, n, parts);
  }

  static HWY_INLINE Complex doubled_factor(const PixelBatch& batch, std::size_t n, Complex unit,
                                           std::size_t first) {
    const Complex g = batch.factor_re.empty() ? unit : times(unit, factor_of(batch, n, first));
    return {hn::Add(g.re, g.re), hn::Add(g.im, g.im)};
  }

  template <std::size_t kCount>
  HWY_INLINE void add_to_bin(const SweepBasis& basis, std::size_t n, const V (&parts)[kCount]) {
    if (n < basis.bin_stride) {
      for (std::size_t part = 0; part < kCount; ++part) bins_[n][part] = parts[part];
      return;
    }
    V* const bin = bins_[basis.bin_of[n]];
    for (std::size_t part = 0; part < kCount; part += 2) {
      bin[part] = hn::Add(bin[part], parts[part]);
      bin[part + 1] = basis.is_mirrored[n] ? hn::Sub(bin[part + 1], parts[part + 1])
                                           : hn::Add(bin[part + 1], parts[part + 1]);
    }
  }

  template <typename Add>
  HWY_INLINE void for_quartered(const SweepBasis& basis, const Add& add) const {
    add_ends(basis, add);
    for (std::size_t j = 1; j < basis.sample_count / 4; ++j) add_quadruple(basis, j, add);
  }

  // Samples j, S/2 - j, S/2 + j and S - j.
  template <typename Add>
  HWY_INLINE void add_quadruple(const SweepBasis& basis, std::size_t j, const Add& add) const {
    const std::size_t half = basis.sample_count / 2;
    const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
    Sums4 odd_cos, odd_sin, even_cos, even_sin;
    for (std::size_t f = 0; f < 4; ++f) {
      even_cos[f] = bins_[0][2 * f];
      odd_cos[f] = odd_sin[f] = even_sin[f] = hn::Zero(D());
    }
    add_bins(waves, 1, odd_cos, odd_sin);
    add_bins(waves, 2, even_cos, even_sin);
    Sums4 near, far, near_sin, far_sin;
    for (std::size_t f = 0; f < 4; ++f) {
      near[f] = hn::Add(even_cos[f], odd_cos[f]);
      far[f] = hn::Sub(even_cos[f], odd_cos[f]);
      near_sin[f] = hn::Add(even_sin[f], odd_sin[f]);
      far_sin[f] = hn::Sub(even_sin[f], odd_sin[f]);
    }
    add(j, plus(near, near_sin));
    add(half - j, minus(far, far_sin));
    add(half + j, plus(far, far_sin));
    add(2 * half - j, minus(near, near_sin));
  }

  // Samples 0 and S/2, which have no sines, S/4 and 3 S/4, whose odd harmonics have no cosines and
  // whose even ones no sines.
  template <typename Add>
  HWY_INLINE void add_ends(const SweepBasis& basis, const Add& add) const {
    const std::size_t quarter = basis.sample_count / 4;
    const float* const waves = basis.waves.data() + 2 * quarter * basis.bin_stride;
    Sums4 even, odd, even_turned, odd_turned;
    for (std::size_t f = 0; f < 4; ++f) {
      even[f] = even_turned[f] = bins_[0][2 * f];
      odd[f] = odd_turned[f] = hn::Zero(D());
    }
    for (std::size_t bin = 1; bin < bin_count_; bin += 2) {
      const V sine = hn::Set(D(), waves[2 * bin + 1]);
      for (std::size_t f = 0; f < 4; ++f) {
        odd[f] = hn::Add(odd[f], bins_[bin][2 * f]);
        odd_turned[f] = hn::MulAdd(bins_[bin][2 * f + 1], sine, odd_turned[f]);
      }
    }
    for (std::size_t bin = 2; bin < bin_count_; bin += 2) {
      const V cosine = hn::Set(D(), waves[2 * bin]);
      for (std::size_t f = 0; f < 4; ++f) {
        even[f] = hn::Add(even[f], bins_[bin][2 * f]);
        even_turned[f] = hn::MulAdd(bins_[bin][2 * f], cosine, even_turned[f]);
      }
    }
    add(0, plus(even, odd));
    add(2 * quarter, minus(even, odd));
    add(quarter, plus(even_turned, odd_turned));
    add(3 * quarter, minus(even_turned, odd_turned));
  }

  template <typename Add>
  HWY_INLINE void for_shared_shifts(const SweepBasis& basis, const Add& add) const {
    for (std::size_t j = 0; j < basis.sample_count; ++j) {
      const float* const waves = basis.waves.data() + 2 * j * basis.bin_stride;
      Sums4 cosines, sines;
      for (std::size_t f = 0; f < 4; ++f) cosines[f] = bins_[0][2 * f], sines[f] = hn::Zero(D());
      add_bins(waves, 1, cosines, sines);
      add_bins(waves, 2, cosines, sines);
      add(j, plus(cosines, sines));
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
      add(j, plus(cosines, sines));
    }
  }

  // Adds every second bin from `first_bin` on.
  HWY_INLINE void add_bins(const float* waves, std::size_t first_bin, Sums4& cosines,
                           Sums4& sines) const {
    const D d;
    for (std::size_t bin = first_bin; bin < bin_count_; bin += 2) {
      const V cosine = hn::Set(d, waves[2 * bin]), sine = hn::Set(d, waves[2 * bin + 1]);
      for (std::size_t f = 0; f < 4; ++f) {
        cosines[f] = hn::MulAdd(bins_[bin][2 * f], cosine, cosines[f]);
        sines[f] = hn::MulAdd(bins_[bin][2 * f + 1], sine, sines[f]);
      }
    }
  }

  static HWY_INLINE Sample plus(const Sums4& a, const Sums4& b) {
    return {hn::Add(a[0], b[0]), hn::Add(a[1], b[1]), hn::Add(a[2], b[2]), hn::Add(a[3], b[3])};
  }
  static HWY_INLINE Sample minus(const Sums4& a, const Sums4& b) {
    return {hn::Sub(a[0], b[0]), hn::Sub(a[1], b[1]), hn::Sub(a[2], b[2]), hn::Sub(a[3], b[3])};
  }

  HWY_ALIGN float nodes_[4][kMostBlocks][4][kRowFloats];
  const float* node_of_[kLanes];
  std::size_t used_[kLanes];  // blocks of each lane
  std::size_t curvature_stride_ = 0, block_count_ = 0, harmonic_count_ = 0;
  HWY_ALIGN float least_size_[kMostBlocks][kLanes];  // of a block that matters
  HWY_ALIGN float greatest_last_[kLanes];            // of the table's last block
  HWY_ALIGN std::int32_t suffices_[kLanes];
  Bin bins_[kMostBatchHarmonics + 1];
  std::size_t bin_count_ = 0;
  bool is_cut_off_ = false;
  float per_period_ = 0;
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
