#include "estimation/motion/block_change.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <numeric>
#include <opencv2/core.hpp>

namespace estimation {
namespace {

// Neighbouring cells share their noise: a fit of smoothed cells has so many times fewer of them.
constexpr double kCellsShared = 4 * std::numbers::pi * kFineSmoothing * kFineSmoothing;

// `variance` of a weighted residual.
std::optional<BlockChange> block_change(const AlignmentSums& sums, const Alignment& whole,
                                        double variance) {
  constexpr int kFewestCells = 12;
  if (sums.cell_count < kFewestCells) return std::nullopt;
  const cv::Matx44d& m = sums.matrix;
  // The direction of the strongest gradients: the larger eigenvector of their 2 x 2 part.
  const double angle = 0.5 * std::atan2(2 * m(0, 1), m(0, 0) - m(1, 1));
  const double e_row = std::cos(angle), e_col = std::sin(angle);
  const double along =
      e_row * e_row * m(0, 0) + 2 * e_row * e_col * m(0, 1) + e_col * e_col * m(1, 1);
  const double mixed = e_row * m(0, 2) + e_col * m(1, 2);
  const double determinant = along * m(2, 2) - mixed * mixed;
  if (!(determinant > 1e-9 * along * m(2, 2)) || !(along > 0)) return std::nullopt;
  const double b_shift = -(e_row * sums.vector[0] + e_col * sums.vector[1]);
  const double b_gain = -sums.vector[2];
  const double shift = (b_shift * m(2, 2) - b_gain * mixed) / determinant;
  const double gain = (b_gain * along - b_shift * mixed) / determinant;
  return BlockChange{.shift_cells = e_row * whole.row + e_col * whole.col + shift,
                     .shift_sd_cells = std::sqrt(variance * m(2, 2) / determinant),
                     .light_frac = gain / whole.gain,
                     .light_sd_frac = std::sqrt(variance * along / determinant) / whole.gain};
}

}  // namespace

std::vector<std::optional<BlockChange>> block_changes(const std::vector<AlignmentSums>& sums,
                                                      const Alignment& whole) {
  std::vector<double> variances;
  for (const AlignmentSums& block : sums)
    if (block.cell_count > 0) variances.push_back(block.squares / block.cell_count);
  const double variance = kCellsShared * median_of(std::move(variances));
  std::vector<std::optional<BlockChange>> changes;
  changes.reserve(sums.size());
  for (const AlignmentSums& block : sums) changes.push_back(block_change(block, whole, variance));
  return changes;
}

// Blocks that changed by themselves, those that touch as one place.
std::vector<LocalChange> find_local_changes(const std::vector<std::optional<BlockChange>>& changes,
                                            const PictureBlocks& blocks, int bin_px) {
  std::vector<double> sizes;
  int top = blocks.rows, bottom = -1;
  for (std::size_t i = 0; i < changes.size(); ++i) {
    if (!changes[i]) continue;
    sizes.push_back(std::abs(changes[i]->light_frac));
    top = std::min(top, static_cast<int>(i) / blocks.cols);
    bottom = std::max(bottom, static_cast<int>(i) / blocks.cols);
  }
  constexpr double kLeastChange = 0.03;  // of the light; less is not worth a retake
  const double usual = 1.4826 * median_of(std::move(sizes));
  std::vector<bool> is_changed(changes.size(), false);
  for (std::size_t i = 0; i < changes.size(); ++i)
    is_changed[i] =
        changes[i] && std::abs(changes[i]->light_frac) >
                          std::max({kLeastChange, 5 * usual, 5 * changes[i]->light_sd_frac});
  std::vector<LocalChange> places;
  for (std::size_t seed = 0; seed < is_changed.size(); ++seed) {
    if (!is_changed[seed]) continue;
    std::vector<std::size_t> members{seed};
    is_changed[seed] = false;
    int low_row = blocks.rows, high_row = -1, low_col = blocks.cols, high_col = -1;
    LocalChange place;
    for (std::size_t next = 0; next < members.size(); ++next) {
      const int row = static_cast<int>(members[next]) / blocks.cols;
      const int col = static_cast<int>(members[next]) % blocks.cols;
      low_row = std::min(low_row, row), high_row = std::max(high_row, row);
      low_col = std::min(low_col, col), high_col = std::max(high_col, col);
      const BlockChange& change = *changes[members[next]];
      if (std::abs(change.light_frac) > std::abs(place.change_frac))
        place.change_frac = change.light_frac, place.sd_frac = change.light_sd_frac;
      for (int r = std::max(0, row - 1); r <= std::min(blocks.rows - 1, row + 1); ++r) {
        for (int c = std::max(0, col - 1); c <= std::min(blocks.cols - 1, col + 1); ++c) {
          const auto neighbour =
              static_cast<std::size_t>(r) * static_cast<std::size_t>(blocks.cols) +
              static_cast<std::size_t>(c);
          if (!is_changed[neighbour]) continue;
          is_changed[neighbour] = false;
          members.push_back(neighbour);
        }
      }
    }
    const double side_px = static_cast<double>(blocks.side) * bin_px;
    place.height_px = (high_row - low_row + 1) * side_px;
    place.width_px = (high_col - low_col + 1) * side_px;
    place.row_px = low_row * side_px + place.height_px / 2 - 0.5;
    place.col_px = low_col * side_px + place.width_px / 2 - 0.5;
    place.height_frac = ((low_row + high_row) / 2.0 - top + 0.5) / (bottom - top + 1);
    places.push_back(place);
  }
  std::sort(places.begin(), places.end(), [](const LocalChange& a, const LocalChange& b) {
    return std::abs(a.change_frac) > std::abs(b.change_frac);
  });
  return places;
}

double rms_shift_cells(const std::vector<std::optional<BlockChange>>& changes) {
  constexpr double kWorstSdCells = 0.25;
  std::vector<double> squares;
  for (const auto& change : changes)
    if (change && change->shift_sd_cells < kWorstSdCells)
      squares.push_back(change->shift_cells * change->shift_cells -
                        change->shift_sd_cells * change->shift_sd_cells);
  std::sort(squares.begin(), squares.end());
  squares.resize(squares.size() * 95 / 100);
  if (squares.empty()) return 0;
  const double sum = std::accumulate(squares.begin(), squares.end(), 0.0);
  return std::sqrt(std::max(0.0, sum / static_cast<double>(squares.size())));
}

}  // namespace estimation
