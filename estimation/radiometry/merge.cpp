#include "estimation/radiometry/merge.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// By exposure, so that the sums do not depend on the order of arrival. Equal exposures share their
// black, and sums of two such numbers commute; callers with three or more keep the manifest's
// order.
std::vector<ExposedFrame> in_fixed_order(std::span<const ExposedFrame> frames) {
  std::vector<ExposedFrame> sorted(frames.begin(), frames.end());
  std::stable_sort(sorted.begin(), sorted.end(),
                   [](const auto& a, const auto& b) { return a.exposure_us < b.exposure_us; });
  return sorted;
}

}  // namespace

CameraBlack::CameraBlack(std::vector<Dark> darks) {
  check(!darks.empty(), "a camera black needs a level or a dark frame");
  std::stable_sort(darks.begin(), darks.end(),
                   [](const Dark& a, const Dark& b) { return a.exposure_us < b.exposure_us; });
  for (std::size_t first = 0; first < darks.size();) {
    std::size_t last = first;
    while (last < darks.size() && darks[last].exposure_us == darks[first].exposure_us) ++last;
    const Image<std::uint16_t>& like = darks[first].dn;
    Averaged averaged{.exposure_us = darks[first].exposure_us,
                      .dn = Image<float>(like.height_px(), like.width_px(), like.channel_count())};
    double total = 0;
    for (std::size_t sample = 0; sample < like.samples().size(); ++sample) {
      double sum = 0;
      for (std::size_t i = first; i < last; ++i) {
        check(darks[i].dn.samples().size() == like.samples().size(), "dark frames of one size");
        sum += darks[i].dn.samples()[sample];
      }
      sum /= static_cast<double>(last - first);
      averaged.dn.samples()[sample] = static_cast<float>(sum);
      total += sum;
    }
    averaged.mean_dn = total / static_cast<double>(std::max<std::size_t>(like.samples().size(), 1));
    darks_.push_back(std::move(averaged));
    first = last;
  }
}

CameraBlack::Between CameraBlack::between(double exposure_us) const {
  const auto upper = std::find_if(darks_.begin(), darks_.end(), [&](const Averaged& dark) {
    return dark.exposure_us >= exposure_us;
  });
  if (upper == darks_.begin()) return {};
  const auto index = static_cast<std::size_t>(upper - darks_.begin());
  if (upper == darks_.end()) return {.lower = index - 1, .upper = index - 1};
  const double span_us = upper->exposure_us - darks_[index - 1].exposure_us;
  return {.lower = index - 1,
          .upper = index,
          .fraction = (exposure_us - darks_[index - 1].exposure_us) / span_us};
}

void CameraBlack::row(double exposure_us, int row, std::span<float> out) const {
  if (darks_.empty()) {
    std::fill(out.begin(), out.end(), static_cast<float>(level_dn_));
    return;
  }
  const Between pair = between(exposure_us);
  const std::span<const float> lower = darks_[pair.lower].dn.view().row(row);
  const std::span<const float> upper = darks_[pair.upper].dn.view().row(row);
  check(lower.size() == out.size(), "dark frames have the frames' size");
  const float fraction = static_cast<float>(pair.fraction);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = lower[i] + fraction * (upper[i] - lower[i]);
}

double CameraBlack::mean_dn(double exposure_us) const {
  if (darks_.empty()) return level_dn_;
  const Between pair = between(exposure_us);
  return std::lerp(darks_[pair.lower].mean_dn, darks_[pair.upper].mean_dn, pair.fraction);
}

Image<float> merge_brackets(std::span<const ExposedFrame> frames, const CameraBlack& black,
                            double saturation_dn, ImageView<const float> flat_field) {
  check(!frames.empty(), "a bracket has at least one frame");
  const std::vector<ExposedFrame> sorted = in_fixed_order(frames);
  const ImageView<const std::uint16_t>& like = sorted.front().dn;
  Image<float> rate(like.height_px, like.width_px, like.channel_count);
  tbb::parallel_for(0, like.height_px, [&](int row) {
    const std::span<float> out = rate.view().row(row);
    std::vector<float> black_dn(out.size());
    std::vector<double> sum_dn(out.size(), 0), sum_us(out.size(), 0);
    for (const ExposedFrame& frame : sorted) {
      const std::span<const std::uint16_t> dn = frame.dn.row(row);
      check(dn.size() == out.size(), "frames of one bracket have one size");
      black.row(frame.exposure_us, row, black_dn);
      for (std::size_t i = 0; i < out.size(); ++i) {
        const bool usable = dn[i] < saturation_dn;
        sum_dn[i] += usable ? static_cast<double>(dn[i]) - static_cast<double>(black_dn[i]) : 0.0;
        sum_us[i] += usable ? frame.exposure_us : 0.0;
      }
    }
    for (std::size_t i = 0; i < out.size(); ++i)
      out[i] = sum_us[i] > 0 ? static_cast<float>(sum_dn[i] / sum_us[i]) : kNan;
    if (flat_field.empty()) return;
    const auto channels = static_cast<std::size_t>(like.channel_count);
    const std::span<const float> flat = flat_field.row(row);
    for (std::size_t i = 0; i < out.size(); ++i) {
      const float gain = flat[i / channels];
      out[i] = gain > 0 ? out[i] / gain : kNan;
    }
  });
  return rate;
}

}  // namespace estimation
