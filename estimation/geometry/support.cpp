#include "estimation/geometry/support.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/geometry/support.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#ifndef ESTIMATION_GEOMETRY_SUPPORT_ONCE
#define ESTIMATION_GEOMETRY_SUPPORT_ONCE
namespace estimation {

constexpr int kRadiusPx = 3;
constexpr int kNeighbourCount = (2 * kRadiusPx + 1) * (2 * kRadiusPx + 1) - 1;
constexpr float kMinSupportCount = 4;

// The rows around one, each led by kRadiusPx samples and followed by a vector of them that are NaN
// beyond the picture; what is close to how far a neighbour.
struct Neighbourhood {
  std::array<const float*, 2 * kRadiusPx + 1> rows{};
  std::array<float, kRadiusPx + 1> tolerance_px{};  // [distance]
  float min_support_frac = 0;
};

}  // namespace estimation
#endif

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;

struct Counts {
  V decoded, close;
};

// The neighbours at just this distance, or at most this distance where `is_ring` is false.
template <int kDistance, bool kIsRing>
HWY_INLINE void count(const Neighbourhood& around, std::size_t i, V own, Counts& counts) {
  const D d;
  const V one = hn::Set(d, 1.0F);
  for (int dy = -kDistance; dy <= kDistance; ++dy)
    for (int dx = -kDistance; dx <= kDistance; ++dx) {
      const int distance = std::max(std::abs(dx), std::abs(dy));
      if (distance == 0 || (kIsRing && distance != kDistance)) continue;
      const float* row = around.rows[static_cast<std::size_t>(dy + kRadiusPx)];
      const V there = hn::LoadU(d, row + i + static_cast<std::size_t>(dx + kRadiusPx));
      const V limit = hn::Set(d, around.tolerance_px[static_cast<std::size_t>(distance)]);
      const auto is_close = hn::Le(hn::Abs(hn::Sub(there, own)), limit);
      counts.close = hn::Add(counts.close, hn::IfThenElseZero(is_close, one));
      const auto is_decoded = hn::Eq(there, there);
      counts.decoded = hn::Add(counts.decoded, hn::IfThenElseZero(is_decoded, one));
    }
}

// 1 or 0 for each of [0, width), in whole vectors.
void mark_supported(const Neighbourhood& around, std::size_t width, float* supported) {
  const D d;
  const V frac = hn::Set(d, around.min_support_frac), least = hn::Set(d, kMinSupportCount);
  const V enough = hn::Max(least, hn::Mul(frac, hn::Set(d, float{kNeighbourCount})));
  for (std::size_t i = 0; i < width; i += hn::Lanes(d)) {
    const V own = hn::LoadU(d, around.rows[kRadiusPx] + i + kRadiusPx);
    const auto is_decoded = hn::Eq(own, own);
    Counts counts{hn::Zero(d), hn::Zero(d)};
    auto is_supported = is_decoded;
    if (!hn::AllFalse(d, is_decoded)) {
      count<2, false>(around, i, own, counts);
      // As many as all 48 could ask for: the farther ones need not be looked at.
      const auto has_enough = hn::Or(hn::Ge(counts.close, enough), hn::Not(is_decoded));
      if (!hn::AllTrue(d, has_enough)) {
        count<3, true>(around, i, own, counts);
        const V asked = hn::Max(least, hn::Mul(frac, counts.decoded));
        is_supported = hn::And(is_decoded, hn::Ge(counts.close, asked));
      }
    }
    hn::StoreU(hn::IfThenElseZero(is_supported, hn::Set(d, 1.0F)), d, supported + i);
  }
}

std::size_t lanes() { return hn::Lanes(D()); }

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(mark_supported);
HWY_EXPORT(lanes);

namespace {

// What noise and a colour's own bias may add between neighbours, projector px.
constexpr float kSlackPx = 1.5F;
// A slanted surface may change this many times faster than the median one.
constexpr float kSlopeFactor = 3;
constexpr float kMinSlope = 0.3F;

// Median change between horizontal neighbours and between vertical ones, whichever is larger.
float typical_slope(ImageView<const float> position_px) {
  constexpr int kStepPx = 3;
  std::vector<float> across, down;
  for (int row = 0; row + 1 < position_px.height_px; row += kStepPx) {
    for (int col = row / kStepPx % kStepPx; col + 1 < position_px.width_px; col += kStepPx) {
      const float here = position_px.at(row, col);
      const float dx = std::abs(position_px.at(row, col + 1) - here);
      const float dy = std::abs(position_px.at(row + 1, col) - here);
      if (!std::isnan(dx)) across.push_back(dx);
      if (!std::isnan(dy)) down.push_back(dy);
    }
  }
  const auto median = [](std::vector<float>& values) {
    if (values.empty()) return 0.0F;
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  };
  return std::max({median(across), median(down), kMinSlope});
}

// Rows [begin - kRadiusPx, end + kRadiusPx), padded.
class PaddedRows {
 public:
  PaddedRows(ImageView<const float> image, int begin, int end)
      : first_(begin - kRadiusPx),
        stride_(static_cast<std::size_t>(image.width_px) + 2 * kRadiusPx +
                HWY_DYNAMIC_DISPATCH(lanes)()),
        samples_(stride_ * static_cast<std::size_t>(end - begin + 2 * kRadiusPx),
                 std::numeric_limits<float>::quiet_NaN()) {
    for (int row = std::max(first_, 0); row < std::min(end + kRadiusPx, image.height_px); ++row) {
      const auto from = image.row(row);
      std::copy(from.begin(), from.end(), at(row) + kRadiusPx);
    }
  }

  float* at(int row) { return samples_.data() + static_cast<std::size_t>(row - first_) * stride_; }
  std::size_t stride() const { return stride_; }

 private:
  int first_;
  std::size_t stride_;
  std::vector<float> samples_;
};

}  // namespace

Image<unsigned char> find_supported(ImageView<const float> position_px, double min_support_frac) {
  Image<unsigned char> supported(position_px.height_px, position_px.width_px);
  const float slope = typical_slope(position_px);
  Neighbourhood like;
  like.min_support_frac = static_cast<float>(min_support_frac);
  for (std::size_t distance = 0; distance < like.tolerance_px.size(); ++distance)
    like.tolerance_px[distance] = kSlackPx + kSlopeFactor * slope * static_cast<float>(distance);
  const auto all_rows = oneapi::tbb::blocked_range<int>(0, position_px.height_px, 16);
  oneapi::tbb::parallel_for(all_rows, [&](const oneapi::tbb::blocked_range<int>& range) {
    PaddedRows rows(position_px, range.begin(), range.end());
    std::vector<float> marks(rows.stride());
    Neighbourhood around = like;
    for (int row = range.begin(); row < range.end(); ++row) {
      for (int dy = -kRadiusPx; dy <= kRadiusPx; ++dy)
        around.rows[static_cast<std::size_t>(dy + kRadiusPx)] = rows.at(row + dy);
      const auto out = supported.view().row(row);
      HWY_DYNAMIC_DISPATCH(mark_supported)(around, out.size(), marks.data());
      for (std::size_t col = 0; col < out.size(); ++col) out[col] = marks[col] != 0 ? 1 : 0;
    }
  });
  return supported;
}

}  // namespace estimation
#endif
