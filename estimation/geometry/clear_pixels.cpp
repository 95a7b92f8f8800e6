#include "estimation/geometry/clear_pixels.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "estimation/geometry/combining.h"
#include "estimation/geometry/period.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/geometry/clear_pixels.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Vectors = hn::ScalableTag<float>;
using One = hn::CappedTag<float, 1>;  // what is left at a row's end

template <typename D>
using Of = hn::Vec<D>;
template <typename D>
using MaskOf = hn::Mask<D>;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
// A clear bit's contrast is this close to the soft one of its place.
constexpr float kMostOff = 0.5F;

template <typename D>
struct Reading {
  Of<D> position_px, sd_px;
  MaskOf<D> is_clear;
};

template <typename D>
HWY_INLINE Of<D> remainder_of(D d, Of<D> value, float period) {
  const auto turns = hn::Round(hn::Mul(value, hn::Set(d, 1 / period)));
  return hn::NegMulAdd(turns, hn::Set(d, period), value);
}

// The code's bits, the highest first, as a number; `is_read` becomes false where one is not known.
template <typename D>
HWY_INLINE Of<D> read_code(D d, const ClearCode& code, const AxisRow& rows, std::size_t i,
                           MaskOf<D>& is_read) {
  auto number = hn::Zero(d), previous = hn::Zero(d);
  const auto one = hn::Set(d, 1.0F);
  for (std::size_t j = 0; j < code.bit_count; ++j) {
    const auto value = hn::LoadU(d, rows.bit_value[j].data() + i);
    is_read = hn::And(is_read, hn::Eq(value, value));
    const auto flipped = hn::Sub(one, previous);
    previous = hn::IfThenElse(hn::Gt(value, hn::Zero(d)), flipped, previous);
    number = hn::Add(hn::Add(number, number), previous);
  }
  return number;
}

// soft_gray_bit of every lane.
template <typename D>
HWY_INLINE Of<D> soft_bit(D d, int bit, Of<D> position_px) {
  const auto run_px = static_cast<float>(1 << bit);
  const float ramp_px = run_px < kGrayRampPx ? run_px : kGrayRampPx;
  const auto past_edge = hn::Add(position_px, hn::Set(d, 0.5F - 2 * run_px));
  const auto past_centre = hn::Abs(remainder_of(d, past_edge, 4 * run_px));
  const auto inside = hn::Sub(hn::Set(d, run_px), past_centre);
  return hn::Max(hn::Min(hn::Mul(inside, hn::Set(d, 1 / ramp_px)), hn::Set(d, 1.0F)),
                 hn::Set(d, -1.0F));
}

template <typename D>
HWY_INLINE MaskOf<D> bits_agree(D d, const ClearCode& code, const AxisRow& rows, std::size_t i,
                                Of<D> position_px, MaskOf<D> so_far) {
  const auto scale = hn::Div(hn::Set(d, 1.0F), hn::LoadU(d, rows.contrast.data() + i));
  int bit = code.low_bit + static_cast<int>(code.bit_count) - 1;
  for (std::size_t j = 0; j < code.bit_count; ++j, --bit) {
    auto value = hn::Mul(hn::LoadU(d, rows.bit_value[j].data() + i), scale);
    value = hn::Max(hn::Min(value, hn::Set(d, 1.0F)), hn::Set(d, -1.0F));
    const auto off = hn::Abs(hn::Sub(value, soft_bit(d, bit, position_px)));
    so_far = hn::And(so_far, hn::Le(off, hn::Set(d, kMostOff)));
  }
  return so_far;
}

// The position near `coarse_px` at which all phases agree.
template <typename D>
HWY_INLINE Reading<D> fuse_phases(D d, const ClearCode& code, const AxisRow& rows,
                                  const ClearLimits& limits, std::size_t i, Of<D> coarse_px,
                                  MaskOf<D> is_clear) {
  const auto least = hn::Set(d, kLeastSdPx * kLeastSdPx);
  const FamilyRow& first = rows.families.front();
  const auto phase_px = hn::LoadU(d, first.position_px.data() + i);
  const auto base_px =
      hn::Sub(coarse_px, remainder_of(d, hn::Sub(coarse_px, phase_px), code.period_px.front()));
  auto weights = hn::Zero(d), sum = hn::Zero(d), least_sd = hn::Set(d, limits.max_sd_px);
  MaskOf<D> is_fine = hn::Lt(least_sd, hn::Zero(d));
  for (const FamilyRow& family : rows.families) {
    const auto sd = hn::LoadU(d, family.sd_px.data() + i);
    is_fine = hn::Or(is_fine, hn::Le(sd, least_sd));
    least_sd = hn::Min(least_sd, sd);
  }
  is_clear = hn::And(is_clear, is_fine);
  const auto least_variance = hn::MulAdd(least_sd, least_sd, least);
  for (std::size_t f = 0; f < rows.families.size(); ++f) {
    const auto sd = hn::LoadU(d, rows.families[f].sd_px.data() + i);
    const auto position = hn::LoadU(d, rows.families[f].position_px.data() + i);
    const auto residual_px = remainder_of(d, hn::Sub(position, base_px), code.period_px[f]);
    const auto variance = hn::MulAdd(sd, sd, least);
    const auto agreement_px = hn::MulAdd(hn::Set(d, static_cast<float>(kAgreementSd)),
                                         hn::Sqrt(hn::Add(variance, least_variance)),
                                         hn::Set(d, static_cast<float>(kAgreementSlackPx)));
    is_clear = hn::And(is_clear, hn::Le(hn::Abs(residual_px), agreement_px));  // NaN is not
    // Else the first phase does not tell the periods of this one apart.
    const auto quarter_px = hn::Set(d, code.period_px[f] / 4);
    is_clear = hn::And(is_clear, hn::Le(agreement_px, quarter_px));
    const auto weight = hn::Div(hn::Set(d, 1.0F), variance);
    weights = hn::Add(weights, weight);
    sum = hn::MulAdd(weight, residual_px, sum);
  }
  const auto position_px = hn::Add(base_px, hn::Div(sum, weights));
  const auto sd_px = hn::Sqrt(hn::Div(hn::Set(d, 1.0F), weights));
  const auto is_inside =
      hn::And(hn::Gt(base_px, hn::Set(d, static_cast<float>(-kOutsidePx))),
              hn::Lt(base_px, hn::Set(d, static_cast<float>(code.size_px - 1 + kOutsidePx))));
  return {position_px, sd_px, hn::And(is_clear, is_inside)};
}

// Whole columns, or pairs of them where the lowest bit is lost in noise.
template <typename D>
HWY_INLINE Reading<D> whole_columns(D d, const ClearCode& code, const AxisRow& rows, std::size_t i,
                                    Of<D> number, MaskOf<D> is_clear) {
  const auto value = hn::LoadU(d, rows.bit_value[code.bit_count - 1].data() + i);
  const auto variance = hn::LoadU(d, rows.bit_variance[code.bit_count - 1].data() + i);
  const auto has_low = hn::Gt(hn::Mul(value, value), hn::Mul(hn::Set(d, 9.0F), variance));
  const auto half = hn::Set(d, 0.5F);
  const auto pair_px = hn::MulAdd(hn::Floor(hn::Mul(number, half)), hn::Set(d, 2.0F), half);
  const auto position_px = hn::IfThenElse(has_low, number, pair_px);
  const auto column_sd = hn::Set(d, 1 / std::sqrt(12.0F));
  const auto sd_px = hn::IfThenElse(has_low, column_sd, hn::Add(column_sd, column_sd));
  const auto is_inside = hn::Le(position_px, hn::Set(d, static_cast<float>(code.size_px)));
  return {position_px, sd_px, hn::And(is_clear, is_inside)};
}

template <typename D>
HWY_INLINE void decode_clear_at(D d, const ClearCode& code, const AxisRow& rows,
                                const ClearLimits& limits, std::size_t i, float* position_px,
                                float* sd_px) {
  const auto contrast = hn::LoadU(d, rows.contrast.data() + i);
  const auto least = hn::Mul(hn::Set(d, limits.min_modulation_sd),
                             hn::Sqrt(hn::LoadU(d, rows.contrast_variance.data() + i)));
  MaskOf<D> is_clear = hn::Gt(contrast, least);
  const auto number = read_code(d, code, rows, i, is_clear);
  Reading<D> reading;
  if (code.period_px.empty()) {
    reading = whole_columns(d, code, rows, i, number, is_clear);
  } else {
    const auto run_px = static_cast<float>(1 << code.low_bit);
    const auto coarse_px = hn::MulAdd(number, hn::Set(d, run_px), hn::Set(d, 0.5F * run_px - 0.5F));
    reading = fuse_phases(d, code, rows, limits, i, coarse_px, is_clear);
    reading.is_clear = bits_agree(d, code, rows, i, reading.position_px, reading.is_clear);
  }
  const auto nothing = hn::Set(d, kNaN);
  hn::StoreU(hn::IfThenElse(reading.is_clear, reading.position_px, nothing), d, position_px + i);
  hn::StoreU(hn::IfThenElse(reading.is_clear, reading.sd_px, nothing), d, sd_px + i);
}

void decode_clear_row(const ClearCode& code, const AxisRow& rows, const ClearLimits& limits,
                      std::size_t begin, std::size_t end, float* position_px, float* sd_px) {
  const Vectors d;
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d))
    decode_clear_at(d, code, rows, limits, i, position_px, sd_px);
  for (; i < end; ++i) decode_clear_at(One(), code, rows, limits, i, position_px, sd_px);
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(decode_clear_row);

std::optional<ClearCode> find_clear_code(const AxisPlan& plan) {
  constexpr int kLeastSizePx = 16, kMostSizePx = 1 << 20;
  if (plan.size_px < kLeastSizePx || plan.size_px > kMostSizePx || plan.bits.empty())
    return std::nullopt;
  ClearCode code;
  code.size_px = plan.size_px;
  if (!plan.families.empty()) {
    // A bit misread at its transition is off by one run and a half of the lowest one's.
    const double longest_px = plan.families.front().family.period_px / 3;
    code.low_bit = longest_px < 1 ? 0 : static_cast<int>(std::floor(std::log2(longest_px)));
    for (const FamilySource& source : plan.families)
      code.period_px.push_back(static_cast<float>(source.family.period_px));
  }
  int bit = static_cast<int>(std::bit_width(static_cast<unsigned>(plan.size_px - 1))) - 1;
  if (code.low_bit > bit) return std::nullopt;
  for (; bit >= code.low_bit; --bit, ++code.bit_count)
    if (code.bit_count >= plan.bits.size() || plan.bits[code.bit_count].bit != bit)
      return std::nullopt;
  return code;
}

void decode_clear(const ClearCode& code, const AxisRow& rows, const ClearLimits& limits,
                  std::size_t begin, std::size_t end, float* position_px, float* sd_px) {
  HWY_DYNAMIC_DISPATCH(decode_clear_row)(code, rows, limits, begin, end, position_px, sd_px);
}

}  // namespace estimation
#endif
