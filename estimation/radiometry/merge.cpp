#include "estimation/radiometry/merge.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <span>

#include "estimation/radiometry/merge_row.h"

namespace estimation {
namespace {

constexpr int kRowsAtOnce = 32;

// By exposure, so that the sums do not depend on the order of arrival. Equal exposures share their
// black, and sums of two such numbers commute; callers with three or more keep the manifest's
// order.
std::vector<ExposedFrame> in_fixed_order(std::span<const ExposedFrame> frames) {
  std::vector<ExposedFrame> sorted(frames.begin(), frames.end());
  std::stable_sort(sorted.begin(), sorted.end(),
                   [](const auto& a, const auto& b) { return a.exposure_us < b.exposure_us; });
  return sorted;
}

// The rows of a bracket's frames with their black, one row at a time.
class BracketRows {
 public:
  BracketRows(std::span<const ExposedFrame> frames, const CameraBlack& black, std::size_t width)
      : frames_(frames), black_(black), width_(width), black_dn_(frames.size() * width) {
    if (black.is_one_level()) black.row(0, 0, black_dn_);
  }

  std::span<const ExposedRow> at(int row) {
    rows_.clear();
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      const std::span<float> black_dn{black_dn_.data() + i * width_, width_};
      if (!black_.is_one_level()) black_.row(frames_[i].exposure_us, row, black_dn);
      rows_.push_back({.dn = frames_[i].dn.row(row).data(),
                       .black_dn = black_dn.data(),
                       .exposure_us = static_cast<float>(frames_[i].exposure_us)});
    }
    return rows_;
  }

 private:
  std::span<const ExposedFrame> frames_;
  const CameraBlack& black_;
  std::size_t width_;
  std::vector<float> black_dn_;  // [frame][width]
  std::vector<ExposedRow> rows_;
};

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
  if (pair.fraction == 0 || pair.fraction == 1) {  // a dark of this very exposure: half the memory
    const std::span<const float> dark = pair.fraction == 0 ? lower : upper;
    std::copy(dark.begin(), dark.end(), out.begin());
    return;
  }
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
  const ImageView<const std::uint16_t>& like = frames.front().dn;
  Image<float> rate(like.height_px, like.width_px, like.channel_count);
  merge_brackets_into(frames, black, saturation_dn, flat_field, rate.view());
  return rate;
}

void merge_brackets_into(std::span<const ExposedFrame> frames, const CameraBlack& black,
                         double saturation_dn, ImageView<const float> flat_field,
                         ImageView<float> rate) {
  check(!frames.empty(), "a bracket has at least one frame");
  const std::vector<ExposedFrame> sorted = in_fixed_order(frames);
  for (const ExposedFrame& frame : sorted)
    check(frame.dn.height_px == rate.height_px && frame.dn.width_px == rate.width_px &&
              frame.dn.channel_count == rate.channel_count,
          "frames of one bracket have one size");
  tbb::parallel_for(tbb::blocked_range<int>(0, rate.height_px, kRowsAtOnce), [&](const auto& rows) {
    BracketRows bracket(sorted, black, rate.row(0).size());
    for (int row = rows.begin(); row < rows.end(); ++row) {
      const std::span<const float> flat =
          flat_field.empty() ? std::span<const float>{} : flat_field.row(row);
      merge_row(bracket.at(row), saturation_dn, flat, rate.channel_count, rate.row(row));
    }
  });
}

}  // namespace estimation
