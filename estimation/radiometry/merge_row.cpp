// Memory bound: two bytes in per exposure, four out. The results go past the caches (Stream),
// because a merged image is larger than they are and is not read before the sweep has ended.
#include "estimation/radiometry/merge_row.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/radiometry/merge_row.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Floats = hn::ScalableTag<float>;
using FloatsV = hn::Vec<Floats>;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct Row {
  std::span<const ExposedRow> frames;
  float saturation_dn = 0;
  const float* flat_field = nullptr;
  std::size_t channel_count = 1;
  float* out = nullptr;
};

// The same arithmetic as merge_lanes, without multiplications that a compiler might fuse.
HWY_ATTR void merge_sample(const Row& row, std::size_t i) {
  float sum_dn = 0, sum_us = 0;
  for (const ExposedRow& frame : row.frames) {
    const float dn = frame.dn[i];
    if (dn >= row.saturation_dn) continue;
    sum_dn += dn - frame.black_dn[i];
    sum_us += frame.exposure_us;
  }
  float rate = sum_us > 0 ? sum_dn / sum_us : kNan;
  if (row.flat_field != nullptr) {
    const float gain = row.flat_field[i / row.channel_count];
    rate = gain > 0 ? rate / gain : kNan;
  }
  row.out[i] = rate;
}

HWY_INLINE FloatsV merge_lanes(const Row& row, std::size_t i) {
  const Floats d;
  const hn::RebindToSigned<Floats> di;
  const hn::Rebind<std::uint16_t, Floats> du;
  const FloatsV saturation = hn::Set(d, row.saturation_dn);
  FloatsV sum_dn = hn::Zero(d), sum_us = hn::Zero(d);
  for (const ExposedRow& frame : row.frames) {
    const FloatsV dn = hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(du, frame.dn + i)));
    const auto usable = hn::Lt(dn, saturation);
    const FloatsV signal = hn::Sub(dn, hn::LoadU(d, frame.black_dn + i));
    sum_dn = hn::Add(sum_dn, hn::IfThenElseZero(usable, signal));
    sum_us = hn::Add(sum_us, hn::IfThenElseZero(usable, hn::Set(d, frame.exposure_us)));
  }
  return hn::IfThenElse(hn::Gt(sum_us, hn::Zero(d)), hn::Div(sum_dn, sum_us), hn::Set(d, kNan));
}

HWY_INLINE FloatsV flatten(FloatsV rate, const float* flat_field) {
  const Floats d;
  const FloatsV gain = hn::LoadU(d, flat_field);
  return hn::IfThenElse(hn::Gt(gain, hn::Zero(d)), hn::Div(rate, gain), hn::Set(d, kNan));
}

std::size_t samples_to_alignment(const float* out, std::size_t lanes) {
  const std::size_t place = reinterpret_cast<std::uintptr_t>(out) / sizeof(float) % lanes;
  return place == 0 ? 0 : lanes - place;
}

void merge_row_of_vectors(std::span<const ExposedRow> frames, double saturation_dn,
                          std::span<const float> flat_field, int channel_count,
                          std::span<float> out) {
  const Row row{.frames = frames,
                // whole numbers are below a level exactly if they are below its next whole number
                .saturation_dn = static_cast<float>(std::ceil(std::clamp(saturation_dn, 0.0, 1e5))),
                .flat_field = flat_field.empty() ? nullptr : flat_field.data(),
                .channel_count = static_cast<std::size_t>(channel_count),
                .out = out.data()};
  const bool is_flat_by_lanes = row.flat_field != nullptr && channel_count == 1;
  const Floats d;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  const std::size_t head = std::min(samples_to_alignment(out.data(), lanes), out.size());
  for (; i < head; ++i) merge_sample(row, i);
  if (row.flat_field == nullptr || is_flat_by_lanes)
    for (; i + lanes <= out.size(); i += lanes) {
      const FloatsV rate = merge_lanes(row, i);
      hn::Stream(is_flat_by_lanes ? flatten(rate, row.flat_field + i) : rate, d, row.out + i);
    }
  for (; i < out.size(); ++i) merge_sample(row, i);
  hwy::FlushStream();
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(merge_row_of_vectors);

void merge_row(std::span<const ExposedRow> rows, double saturation_dn,
               std::span<const float> flat_field, int channel_count, std::span<float> out) {
  HWY_DYNAMIC_DISPATCH(merge_row_of_vectors)(rows, saturation_dn, flat_field, channel_count, out);
}

}  // namespace estimation
#endif
