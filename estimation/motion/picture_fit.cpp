#include "estimation/motion/picture_fit.h"

#include <cmath>
#include <numeric>

namespace estimation {
namespace {

double value(const Image<float>& image, int row, int col) {
  return static_cast<double>(image.at(row, col));
}

}  // namespace

// Blocks whose mean light is not far below the brightest ones'.
PictureBlocks find_lit_blocks(const Picture& picture, int blocks_across, int smallest_side) {
  const int height = picture.light.height_px(), width = picture.light.width_px();
  PictureBlocks blocks;
  blocks.side = std::max(smallest_side, width / blocks_across);
  blocks.rows = std::max(1, height / blocks.side);
  blocks.cols = std::max(1, width / blocks.side);
  const auto count = static_cast<std::size_t>(blocks.rows) * static_cast<std::size_t>(blocks.cols);
  std::vector<double> sums(count), counts(count);
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      sums[blocks.at(row, col)] += value(picture.light, row, col);
      counts[blocks.at(row, col)] += 1;
    }
  }
  for (std::size_t i = 0; i < count; ++i) sums[i] /= counts[i];
  std::vector<double> sorted = sums;
  std::sort(sorted.begin(), sorted.end());
  constexpr double kLitFrac = 0.1;
  const double limit_dn = kLitFrac * sorted[(count - 1) * 95 / 100];
  blocks.is_lit.resize(count);
  for (std::size_t i = 0; i < count; ++i) blocks.is_lit[i] = limit_dn > 0 && sums[i] > limit_dn;
  return blocks;
}

PictureFit::PictureFit(const CameraInfo& camera, const Picture& first, const Picture& second,
                       const PictureBlocks& blocks, double smoothing, double period_px)
    : blocks_(blocks),
      smoothing_(smoothing),
      first_(smoothed(first.light, smoothing)),
      mean_(local_mean(first, period_px)),
      second_(second.light),
      first_usable_(shrunk(first.is_usable, kFitMargin)),
      second_usable_(shrunk(second.is_usable, kFitMargin)) {
  double sum_dn = 0;
  for (int row = 0; row < height(); ++row)
    for (int col = 0; col < width(); ++col)
      if (is_compared(row, col)) sum_dn += value(first_, row, col), ++cell_count_;
  lit_dn_ = cell_count_ > 0 ? sum_dn / cell_count_ : 0;
  const double sample_count = first.bin_px * first.bin_px;
  const double gain_e_per_dn = camera.gain_e_per_dn.value_or(1);
  const double read_dn = camera.read_noise_e.value_or(0) / gain_e_per_dn;
  shot_dn_ = 1 / gain_e_per_dn / sample_count;
  // A thousandth of the light beside the noise: what is known no better weighs no more.
  floor_dn2_ = read_dn * read_dn / sample_count + 1e-6 * lit_dn_ * lit_dn_;
}

bool PictureFit::descend(Alignment& at, int step_count) {
  for (int step = 0; step < step_count; ++step) {
    const auto sums = normal_equations(at);
    AlignmentSums all =
        std::accumulate(sums.begin(), sums.end(), AlignmentSums{},
                        [](AlignmentSums sum, const AlignmentSums& each) { return sum += each; });
    const auto change = all.solution();
    if (!change || all.cell_count < cell_count_ / 4) return false;
    // A step of more than two cells trusts the gradients too far.
    constexpr double kLongestStep = 2;
    const double length = std::hypot((*change)[0], (*change)[1]);
    const double share = length > kLongestStep ? kLongestStep / length : 1;
    at.row += share * (*change)[0];
    at.col += share * (*change)[1];
    at.gain += (*change)[2];
    at.ambient += (*change)[3];
    const double farthest = 0.5 * std::min(height(), width());
    if (!(std::hypot(at.row, at.col) < farthest) || !(at.gain > 0.05)) return false;
    if (length < 1e-5 && step > 2) break;
  }
  return true;
}

std::vector<AlignmentSums> PictureFit::normal_equations(const Alignment& at, Outliers outliers) {
  const Image<float> moved = smoothed(second_, smoothing_, {at.row, at.col});
  std::vector<AlignmentSums> sums(blocks_.count());
  std::vector<double> sizes;
  const int row_shift = static_cast<int>(std::lround(at.row));
  const int col_shift = static_cast<int>(std::lround(at.col));
  for (int row = kFitMargin; row < height() - kFitMargin; ++row) {
    for (int col = kFitMargin; col < width() - kFitMargin; ++col) {
      if (!is_compared(row, col) || !is_second_usable(row + row_shift, col + col_shift)) continue;
      const double light = value(first_, row, col), mean = value(mean_, row, col);
      const double residual = value(moved, row, col) - at.gain * light - at.ambient * mean;
      const auto slope = [&](int r, int c) {
        // Of both pictures: to second order that of the way between them.
        return 0.25 *
               (value(moved, row + r, col + c) - value(moved, row - r, col - c) +
                at.gain * (value(first_, row + r, col + c) - value(first_, row - r, col - c)));
      };
      const double noise = std::sqrt(floor_dn2_ + shot_dn_ * std::max(light, 0.0));
      const double size = std::abs(residual) / noise;
      if ((row + col) % 4 == 0) sizes.push_back(size);
      const double limit = 2 * 1.4826 * typical_size_;
      const bool is_outlier = outliers == Outliers::kHeldDown && size > limit;
      const double weight = is_outlier ? limit / size : 1;  // Huber's
      AlignmentSums& block = sums[blocks_.at(row, col)];
      block.add({slope(1, 0), slope(0, 1), -light, -mean}, residual, weight / (noise * noise));
    }
  }
  typical_size_ = std::max(median_of(std::move(sizes)), 1e-6);
  return sums;
}

double PictureFit::unexplained_frac(const Alignment& at) const {
  const Image<float> moved = smoothed(second_, smoothing_, {at.row, at.col});
  double residual_sum = 0, sum = 0, square_sum = 0, weight_sum = 0;
  const int row_shift = static_cast<int>(std::lround(at.row));
  const int col_shift = static_cast<int>(std::lround(at.col));
  for (int row = 0; row < height(); ++row) {
    for (int col = 0; col < width(); ++col) {
      if (!is_compared(row, col) || !is_second_usable(row + row_shift, col + col_shift)) continue;
      const double light = value(moved, row, col);
      const double residual =
          light - at.gain * value(first_, row, col) - at.ambient * value(mean_, row, col);
      residual_sum += residual * residual;
      sum += light;
      square_sum += light * light;
      weight_sum += 1;
    }
  }
  const double variation = square_sum - sum * sum / std::max(weight_sum, 1.0);
  return variation > 0 ? std::sqrt(residual_sum / variation) : 1;
}

}  // namespace estimation
