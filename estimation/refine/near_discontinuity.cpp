#include "estimation/refine/near_discontinuity.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

namespace estimation {
namespace {

constexpr int kBoxBlocks = 2;    // half the width of a box, in quarters of l_d: half an l_d
constexpr int kApartBlocks = 4;  // from the pixel to a box's centre: one l_d
constexpr double kStepSd = 4;
constexpr double kLeastFilled = 0.5;  // of a box, to have a mean

// 255 where a pixel is not lit, holes narrower than `least_px` filled.
cv::Mat1b unlit_mask(const LitSurface& surface, double least_px) {
  cv::Mat1b unlit(surface.height_px(), surface.width_px());
  for (int row = 0; row < unlit.rows; ++row)
    for (int col = 0; col < unlit.cols; ++col) unlit(row, col) = surface.is_lit(row, col) ? 0 : 255;
  cv::Mat1i labels;
  cv::Mat stats, centres;
  const int count = cv::connectedComponentsWithStats(unlit, labels, stats, centres, 4);
  std::vector<char> is_small(static_cast<std::size_t>(count), 0);
  for (int label = 1; label < count; ++label)
    is_small[static_cast<std::size_t>(label)] =
        stats.at<int>(label, cv::CC_STAT_AREA) < least_px * least_px;
  for (int row = 0; row < unlit.rows; ++row)
    for (int col = 0; col < unlit.cols; ++col)
      if (is_small[static_cast<std::size_t>(labels(row, col))] != 0) unlit(row, col) = 0;
  return unlit;
}

bool is_jump(const LitSurface& surface, int row, int col, int other_row, int other_col) {
  return surface.is_lit(row, col) && surface.is_lit(other_row, other_col) &&
         !goes_on(surface, row, col, other_row, other_col);
}

// 0 beside a border of the lit surface, 255 elsewhere; the picture's own edge is no border.
cv::Mat1b away_from_borders(const LitSurface& surface, double least_hole_px) {
  cv::Mat1b away;
  cv::bitwise_not(unlit_mask(surface, least_hole_px), away);
  for (int row = 0; row < away.rows; ++row)
    for (int col = 0; col < away.cols; ++col) {
      if (col + 1 < away.cols && is_jump(surface, row, col, row, col + 1))
        away(row, col) = away(row, col + 1) = 0;
      if (row + 1 < away.rows && is_jump(surface, row, col, row + 1, col))
        away(row, col) = away(row + 1, col) = 0;
    }
  return away;
}

// Sums over blocks of ln(R_d / (1 - R_d)) or ln l_d.
struct Sums {
  double count = 0, sum = 0, squares = 0;
  void add(double value) {
    count += 1;
    sum += value;
    squares += value * value;
  }
  void add(const Sums& other) {
    count += other.count;
    sum += other.sum;
    squares += other.squares;
  }
  double mean() const { return sum / count; }
  double mean_variance() const { return std::max(0.0, squares / count - mean() * mean()) / count; }
};

class BlockGrid {
 public:
  template <typename Value>
  BlockGrid(const LitSurface& surface, int side_px, const Value& value)
      : side_px_(side_px),
        rows_((surface.height_px() + side_px - 1) / side_px),
        cols_((surface.width_px() + side_px - 1) / side_px),
        blocks_(static_cast<std::size_t>(rows_) * static_cast<std::size_t>(cols_)) {
    for (int row = 0; row < surface.height_px(); ++row)
      for (int col = 0; col < surface.width_px(); ++col) {
        if (!surface.is_lit(row, col)) continue;
        const double here = value(row, col);
        if (std::isfinite(here)) block(row / side_px_, col / side_px_).add(here);
      }
  }

  // Whether the mean changes by `least` and significantly across a block, along either axis.
  bool is_step(int row, int col, double least) const {
    return is_step_between(box(row, col - kApartBlocks), box(row, col + kApartBlocks), least) ||
           is_step_between(box(row - kApartBlocks, col), box(row + kApartBlocks, col), least);
  }

 private:
  Sums& block(int row, int col) {
    return blocks_[static_cast<std::size_t>(row) * static_cast<std::size_t>(cols_) +
                   static_cast<std::size_t>(col)];
  }
  std::optional<Sums> box(int row, int col) const {
    if (row < 0 || col < 0 || row >= rows_ || col >= cols_) return std::nullopt;
    Sums total;
    for (int r = std::max(0, row - kBoxBlocks); r <= std::min(rows_ - 1, row + kBoxBlocks); ++r)
      for (int c = std::max(0, col - kBoxBlocks); c <= std::min(cols_ - 1, col + kBoxBlocks); ++c)
        total.add(blocks_[static_cast<std::size_t>(r) * static_cast<std::size_t>(cols_) +
                          static_cast<std::size_t>(c)]);
    const double whole = std::pow((2 * kBoxBlocks + 1) * side_px_, 2);
    if (total.count < kLeastFilled * whole) return std::nullopt;
    return total;
  }
  static bool is_step_between(const std::optional<Sums>& a, const std::optional<Sums>& b,
                              double least) {
    if (!a || !b) return false;
    const double step = std::abs(a->mean() - b->mean());
    return step > least && step > kStepSd * std::sqrt(a->mean_variance() + b->mean_variance());
  }

  int side_px_, rows_, cols_;
  std::vector<Sums> blocks_;
};

// 0 where the material steps, 255 elsewhere.
cv::Mat1b away_from_steps(const LitSurface& surface, const BandMaterial& material, int side_px,
                          const DiscontinuityOptions& options) {
  const BlockGrid reflectance(surface, side_px, [&](int row, int col) {
    return std::log(static_cast<double>(material.diffuse_reflectance.at(row, col)));
  });
  const BlockGrid translucency(surface, side_px, [&](int row, int col) {
    return std::log(static_cast<double>(material.translucency_mm.at(row, col)));
  });
  cv::Mat1b away(surface.height_px(), surface.width_px());
  for (int row = 0; row < away.rows; row += side_px)
    for (int col = 0; col < away.cols; col += side_px) {
      const int r = row / side_px, c = col / side_px;
      const bool is_step = reflectance.is_step(r, c, options.least_reflectance_step_frac) ||
                           translucency.is_step(r, c, options.least_translucency_step_frac);
      away(cv::Rect(col, row, side_px, side_px) & cv::Rect(0, 0, away.cols, away.rows)) =
          is_step ? 0 : 255;
    }
  return away;
}

}  // namespace

Image<unsigned char> near_discontinuity(const LitSurface& surface, const BandMaterial& material,
                                        const DiscontinuityOptions& options) {
  Image<unsigned char> near(surface.height_px(), surface.width_px());
  const double translucency_mm = typical_translucency_mm(surface, material);
  const double pixel_mm = typical_pixel_mm(surface);
  if (!(translucency_mm > 0 && pixel_mm > 0)) return near;
  cv::Mat1f border_px, step_px;
  cv::distanceTransform(away_from_borders(surface, options.least_hole * translucency_mm / pixel_mm),
                        border_px, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  cv::distanceTransform(
      away_from_steps(surface, material, LitPatches::side_for(translucency_mm, pixel_mm), options),
      step_px, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  for (int row = 0; row < near.height_px(); ++row)
    for (int col = 0; col < near.width_px(); ++col) {
      if (!surface.is_lit(row, col)) continue;
      const double own_mm = static_cast<double>(material.translucency_mm.at(row, col));
      const double l_d_px = (own_mm > 0 ? own_mm : translucency_mm) / pixel_mm;
      // The boxes that find a step reach one l_d already.
      near.at(row, col) = static_cast<double>(border_px(row, col)) <= options.reach * l_d_px ||
                          static_cast<double>(step_px(row, col)) <= (options.reach - 1) * l_d_px;
    }
  return near;
}

}  // namespace estimation
