#include "estimation/geometry/filter_rows.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/geometry/filter_rows.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Vectors = hn::ScalableTag<float>;
using One = hn::CappedTag<float, 1>;  // what is left at a row's end

template <typename D>
HWY_INLINE void filter_along_at(D d, const float* samples, const FilterKernels& kernels,
                                std::size_t i, const FilteredRow& out) {
  auto plain = hn::Zero(d), first = hn::Zero(d), second = hn::Zero(d);
  const float* window = samples + i - static_cast<std::size_t>(kernels.radius);
  for (std::size_t k = 0; k < kernels.plain.size(); ++k) {
    const auto sample = hn::LoadU(d, window + k);
    plain = hn::MulAdd(hn::Set(d, kernels.plain[k]), sample, plain);
    first = hn::MulAdd(hn::Set(d, kernels.first[k]), sample, first);
    second = hn::MulAdd(hn::Set(d, kernels.second[k]), sample, second);
  }
  hn::StoreU(plain, d, out.plain + i);
  hn::StoreU(first, d, out.first + i);
  hn::StoreU(second, d, out.second + i);
}

void filter_along(const float* samples, const FilterKernels& kernels, std::size_t begin,
                  std::size_t end, const FilteredRow& out) {
  const Vectors d;
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d)) filter_along_at(d, samples, kernels, i, out);
  for (; i < end; ++i) filter_along_at(One(), samples, kernels, i, out);
}

template <typename D>
HWY_INLINE void filter_across_at(D d, std::span<const FilteredRow> rows,
                                 const FilterKernels& kernels, std::size_t i,
                                 const SmoothedRow& out) {
  auto value = hn::Zero(d), by_col = hn::Zero(d), by_row = hn::Zero(d);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const auto plain = hn::LoadU(d, rows[k].plain + i);
    const float around = kernels.a * kernels.plain[k] + kernels.b * kernels.second[k];
    value = hn::MulAdd(hn::Set(d, around), plain, value);
    value = hn::MulAdd(hn::Set(d, kernels.b * kernels.plain[k]), hn::LoadU(d, rows[k].second + i),
                       value);
    by_col = hn::MulAdd(hn::Set(d, kernels.s * kernels.plain[k]), hn::LoadU(d, rows[k].first + i),
                        by_col);
    by_row = hn::MulAdd(hn::Set(d, kernels.s * kernels.first[k]), plain, by_row);
  }
  hn::StoreU(value, d, out.value + i);
  hn::StoreU(by_col, d, out.by_col + i);
  hn::StoreU(by_row, d, out.by_row + i);
}

void filter_across(std::span<const FilteredRow> rows, const FilterKernels& kernels,
                   std::size_t begin, std::size_t end, const SmoothedRow& out) {
  const Vectors d;
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d)) filter_across_at(d, rows, kernels, i, out);
  for (; i < end; ++i) filter_across_at(One(), rows, kernels, i, out);
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(filter_along);
HWY_EXPORT(filter_across);

void filter_along_row(const float* samples, const FilterKernels& kernels, std::size_t begin,
                      std::size_t end, const FilteredRow& out) {
  HWY_DYNAMIC_DISPATCH(filter_along)(samples, kernels, begin, end, out);
}

void filter_across_rows(std::span<const FilteredRow> rows, const FilterKernels& kernels,
                        std::size_t begin, std::size_t end, const SmoothedRow& out) {
  HWY_DYNAMIC_DISPATCH(filter_across)(rows, kernels, begin, end, out);
}

}  // namespace estimation
#endif
