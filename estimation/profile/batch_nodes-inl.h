// The table of harmonics as vectors of pixels take it: each lane's node, its Taylor terms summed at
// the lane's shape, turned such that a vector holds one harmonic of all lanes.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_NODES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_NODES_INL_H
#undef SSRIG_BATCH_NODES_INL_H
#else
#define SSRIG_BATCH_NODES_INL_H
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "estimation/profile/batch_kernel.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

// Second derivatives only correct the last step, by a tenth of a standard deviation at most.
constexpr float kCoarseCurvature = 25;

// The nodes of a vector of pixels, four harmonics (a block) at a time.
class Nodes {
 public:
  // What a block holds of each harmonic.
  enum Value : std::size_t { kItself, kByLogit, kByLog, kCurvature, kAlongLog };

  // For the pixels to come: which harmonics are left out, and which must not be missing, by their
  // height in a sample.
  HWY_NOINLINE void set_tolerance(const BatchPlan& plan, const PixelBatch& batch, std::size_t first,
                                  V tolerance, V truncation) {
    const D d;
    for (std::size_t block = 0; block < plan.block_count; ++block) {
      V power = hn::Set(d, 1e-20F);
      for (std::size_t n = 4 * block + 1; n <= 4 * block + 4; ++n) {
        const Complex f = factor_of(batch, n, first);
        power = hn::Max(power, hn::MulAdd(f.re, f.re, hn::Mul(f.im, f.im)));
      }
      const V per_factor = hn::Mul(hn::Set(d, 0.5F), hn::ApproximateReciprocalSqrt(power));
      hn::Store(hn::Mul(tolerance, per_factor), d, least_size_[block]);  // G = 2 a f
      if (block + 1 == plan.block_count)
        hn::Store(hn::Mul(truncation, per_factor), d, greatest_last_);
    }
    // Harmonics without a factor are none.
    is_cut_off_ = !batch.factor_re.empty() && batch.factor_count - 1 <= plan.harmonic_count;
  }

  // All blocks that matter, in lanes that are not wanted the first; `coarseness` multiplies the
  // tolerance. False in lanes whose table lacks harmonics that matter.
  HWY_NOINLINE M load(const BatchPlan& plan, V logit, V log, M wanted, float coarseness) {
    const DI di;
    place(plan, logit, log);
    HWY_ALIGN std::int32_t is_wanted[kLanes], suffices[kLanes];
    hn::Store(hn::BitCast(di, hn::VecFromMask(D(), wanted)), di, is_wanted);
    const std::size_t last = plan.block_count - 1;
    block_count_ = bent_block_count_ = 1;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const float* const sizes = plan.sizes + node_[lane] * plan.block_count;
      std::size_t count = is_wanted[lane] != 0 ? plan.block_count : 1;
      while (count > 1 && sizes[count - 1] < coarseness * least_size_[count - 1][lane]) --count;
      suffices[lane] = is_cut_off_ || sizes[last] <= greatest_last_[lane] ? 1 : 0;
      used_[lane] = static_cast<std::int32_t>(count);
      load_lane(lane, count);
      block_count_ = std::max(block_count_, count);
      while (count > 1 && sizes[count - 1] < kCoarseCurvature * least_size_[count - 1][lane])
        --count;
      bent_[lane] = static_cast<std::int32_t>(count);
      bent_block_count_ = std::max(bent_block_count_, count);
    }
    for (const Value value : {kItself, kByLogit, kByLog}) clear_unused(value);
    return hn::RebindMask(D(), hn::Ne(hn::Load(di, suffices), hn::Zero(di)));
  }

  // So many blocks of all lanes.
  HWY_NOINLINE void load_first(const BatchPlan& plan, V logit, V log, std::size_t block_count) {
    place(plan, logit, log);
    block_count_ = block_count;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      used_[lane] = static_cast<std::int32_t>(block_count);
      load_lane(lane, block_count);
    }
  }

  // The second derivatives of what was loaded times this covariance of (t, ln l), halved.
  HWY_NOINLINE void load_curvature(V tt, V tl, V ll) {
    const hn::CappedTag<float, 8> d8;
    HWY_ALIGN float c_tt[kLanes], c_tl[kLanes], c_ll[kLanes];
    hn::Store(tt, D(), c_tt);
    hn::Store(tl, D(), c_tl);
    hn::Store(ll, D(), c_ll);
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const float* const terms = terms_of(lane) + 3 * stride_;
      const auto vtt = hn::Set(d8, c_tt[lane]), vtl = hn::Set(d8, c_tl[lane]),
                 vll = hn::Set(d8, c_ll[lane]);
      for (std::size_t n = 0; n < 4 * static_cast<std::size_t>(bent_[lane]); n += hn::Lanes(d8)) {
        const float* const at = terms + n;
        put(kCurvature, n, lane,
            hn::MulAdd(vtt, hn::LoadU(d8, at),
                       hn::MulAdd(vtl, hn::LoadU(d8, at + stride_),
                                  hn::Mul(vll, hn::LoadU(d8, at + 2 * stride_)))));
      }
    }
  }

  // The second derivatives of the first harmonics times a step of (t, ln l), by t and by ln l.
  template <std::size_t kCount>
  HWY_INLINE void get_curvature_along(V t, V l, V (&by_logit)[kCount], V (&by_log)[kCount]) {
    static_assert(kCount % 8 == 0);
    HWY_ALIGN float twice_t[kLanes], only_t[kLanes], twice_l[kLanes], only_l[kLanes];
    hn::Store(hn::Add(t, t), D(), twice_t);  // the table has halves of second derivatives
    hn::Store(t, D(), only_t);
    hn::Store(hn::Add(l, l), D(), twice_l);
    hn::Store(l, D(), only_l);
    const hn::CappedTag<float, 8> d8;
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      for (std::size_t n = 0; n < kCount; n += hn::Lanes(d8)) {
        const float* const at = terms_of(lane) + 3 * stride_ + n;
        const auto tt = hn::LoadU(d8, at), tl = hn::LoadU(d8, at + stride_),
                   ll = hn::LoadU(d8, at + 2 * stride_);
        put(kCurvature, n, lane,
            hn::MulAdd(tt, hn::Set(d8, twice_t[lane]), hn::Mul(tl, hn::Set(d8, only_l[lane]))));
        put(kAlongLog, n, lane,
            hn::MulAdd(tl, hn::Set(d8, only_t[lane]), hn::Mul(ll, hn::Set(d8, twice_l[lane]))));
      }
    for (std::size_t block = 0; 4 * block < kCount; ++block) {
      V t4[4], l4[4];
      get(kCurvature, block, t4);
      get(kAlongLog, block, l4);
      for (std::size_t i = 0; i < 4; ++i) {
        by_logit[4 * block + i] = t4[i];
        by_log[4 * block + i] = l4[i];
      }
    }
  }

  std::size_t block_count() const { return block_count_; }  // the most of any lane
  // The same of load_curvature, and the lanes that have this one.
  std::size_t bent_block_count() const { return bent_block_count_; }
  HWY_INLINE M is_bent(std::size_t block) const {
    const DI di;
    return hn::RebindMask(
        D(), hn::Gt(hn::Load(di, bent_), hn::Set(di, static_cast<std::int32_t>(block))));
  }

  HWY_INLINE M has_at_most(std::size_t block_count) const {
    const DI di;
    const auto more = hn::Set(di, static_cast<std::int32_t>(block_count + 1));
    return hn::RebindMask(D(), hn::Lt(hn::Load(di, used_), more));
  }

  // The block's four harmonics, each of all lanes.
  HWY_INLINE void get(Value value, std::size_t block, V (&out)[4]) const {
    const D d;
    const auto& rows = values_[value][block];
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

 private:
  // Harmonic by harmonic, four at a time, such that a vector holds the same four of lanes i, 4 + i,
  // 8 + i ...
  static constexpr std::size_t kRowFloats = kLanes < 4 ? 4 : kLanes;
  static constexpr std::size_t kMostBlocks = kMostBatchHarmonics / 4 + 1;

  // Each lane's node and how far from it the lane is.
  HWY_INLINE void place(const BatchPlan& plan, V logit, V log) {
    const D d;
    const DI di;
    const HarmonicTable& table = *plan.table;
    const auto index_of = [&](V at, double least, double step, int count) HWY_ATTR {
      const V index = hn::Round(hn::Mul(hn::Sub(at, hn::Set(d, static_cast<float>(least))),
                                        hn::Set(d, static_cast<float>(1 / step))));
      return hn::Min(hn::Max(index, hn::Zero(d)), hn::Set(d, static_cast<float>(count - 1)));
    };
    const ShapePoint& least = table.range().least;
    const V row = index_of(logit, least.logit_reflectance, table.logit_step(), table.rows());
    const V col = index_of(log, least.log_translucency_px, table.log_step(), table.cols());
    const auto rest = [&](V at, V index, double first, double step) HWY_ATTR {
      return hn::NegMulAdd(index, hn::Set(d, static_cast<float>(step)),
                           hn::Sub(at, hn::Set(d, static_cast<float>(first))));
    };
    hn::Store(rest(logit, row, least.logit_reflectance, table.logit_step()), d, from_logit_);
    hn::Store(rest(log, col, least.log_translucency_px, table.log_step()), d, from_log_);
    HWY_ALIGN std::int32_t rows[kLanes], cols[kLanes];
    hn::Store(hn::ConvertTo(di, row), di, rows);
    hn::Store(hn::ConvertTo(di, col), di, cols);
    terms_ = table.node(0, 0).data();
    stride_ = table.harmonic_stride();
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      node_[lane] = static_cast<std::size_t>(rows[lane] * table.cols() + cols[lane]);
  }

  const float* terms_of(std::size_t lane) const {
    return terms_ + node_[lane] * HarmonicTable::kTerms * stride_;
  }

  std::size_t used(std::size_t lane) const { return static_cast<std::size_t>(used_[lane]); }

  HWY_INLINE float* slot(Value value, std::size_t block, std::size_t lane) {
    return values_[value][block][lane % 4] + 4 * (lane / 4);
  }

  HWY_INLINE void clear_unused(Value value) {
    const hn::CappedTag<float, 4> d4;
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      for (std::size_t block = used(lane); block < block_count_; ++block)
        for (std::size_t i = 0; i < 4; i += hn::Lanes(d4))
          hn::Store(hn::Zero(d4), d4, slot(value, block, lane) + i);
  }

  // Harmonics of one lane from n on, as many as a vector of eight or fewer holds.
  template <typename V8>
  HWY_INLINE void put(Value value, std::size_t n, std::size_t lane, V8 terms) {
    float* const at = slot(value, n / 4, lane) + n % 4;
#if HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_AVX3
    const hn::CappedTag<float, 4> d4;
    hn::Store(hn::LowerHalf(terms), d4, at);
    hn::Store(hn::UpperHalf(d4, terms), d4, slot(value, n / 4 + 1, lane));
#else
    hn::Store(terms, hn::CappedTag<float, 8>(), at);
#endif
  }

  // Two blocks at a time where vectors are long enough: the table's rows are padded to eight, and a
  // block too many is not used.
  HWY_INLINE void load_lane(std::size_t lane, std::size_t block_count) {
    const hn::CappedTag<float, 8> d8;
    const float* HWY_RESTRICT const node = terms_of(lane);
    const std::size_t stride = stride_;
    const auto vt = hn::Set(d8, from_logit_[lane]), vl = hn::Set(d8, from_log_[lane]);
    for (std::size_t n = 0; n < 4 * block_count; n += hn::Lanes(d8)) {
      const float* const at = node + n;
      const auto a = hn::LoadU(d8, at), t = hn::LoadU(d8, at + stride),
                 l = hn::LoadU(d8, at + 2 * stride), tt = hn::LoadU(d8, at + 3 * stride),
                 tl = hn::LoadU(d8, at + 4 * stride), ll = hn::LoadU(d8, at + 5 * stride);
      const auto half_t = hn::MulAdd(vl, tl, hn::MulAdd(vt, tt, t));  // lacks tt once more
      const auto half_l = hn::MulAdd(vl, ll, l);
      put(kItself, n, lane, hn::MulAdd(vl, half_l, hn::MulAdd(vt, half_t, a)));
      put(kByLogit, n, lane, hn::MulAdd(vt, tt, half_t));
      put(kByLog, n, lane, hn::MulAdd(vt, tl, hn::MulAdd(vl, ll, half_l)));
    }
  }

  HWY_ALIGN float values_[5][kMostBlocks][4][kRowFloats];
  HWY_ALIGN float from_logit_[kLanes], from_log_[kLanes];
  std::size_t node_[kLanes];
  const float* terms_ = nullptr;  // of the first node
  std::size_t stride_ = 0;
  HWY_ALIGN std::int32_t used_[kLanes];  // blocks of each lane
  HWY_ALIGN std::int32_t bent_[kLanes];  // of load_curvature
  std::size_t block_count_ = 0, bent_block_count_ = 0;
  HWY_ALIGN float least_size_[kMostBlocks][kLanes];  // of a block that matters
  HWY_ALIGN float greatest_last_[kLanes];            // of the table's last block
  bool is_cut_off_ = false;
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
