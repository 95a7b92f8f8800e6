#include "estimation/motion/frame_change.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <opencv2/core.hpp>
#include <optional>
#include <string>

#include "estimation/motion/picture.h"

namespace estimation {
namespace {

// Cells: enough to make noise and gradients smooth, little against a stripe (some 20 cells).
constexpr double kSmoothing = 1.0, kCoarseSmoothing = 4.0;
constexpr int kMargin = 2;  // cells that smoothing and interpolation reach
// Neighbouring cells share their noise: a fit of smoothed cells has so many times fewer of them.
constexpr double kCellsShared = 4 * std::numbers::pi * kSmoothing * kSmoothing;
constexpr int kBlocksAcross = 24, kSmallestBlock = 8;
// An eye is smaller than what a shift can be told from.
constexpr int kPlacesAcross = 48, kSmallestPlace = 4;

using Vec4 = cv::Vec4d;
using Mat4 = cv::Matx44d;

double value(const Image<float>& image, int row, int col) {
  return static_cast<double>(image.at(row, col));
}

struct Parameters {
  double row = 0, col = 0;       // cells
  double gain = 1, ambient = 0;  // of the first showing's light, and of its local mean
};

// Sums over some cells for r + J x: x = changes of row, col, gain, ambient.
struct NormalEquations {
  Mat4 matrix = Mat4::zeros();
  Vec4 vector{0, 0, 0, 0};  // J^T w r
  double squares = 0;       // w r^2
  int cell_count = 0;

  void add(const Vec4& gradient, double residual, double weight) {
    for (int i = 0; i < 4; ++i) {
      vector[i] += weight * gradient[i] * residual;
      for (int k = 0; k < 4; ++k) matrix(i, k) += weight * gradient[i] * gradient[k];
    }
    squares += weight * residual * residual;
    ++cell_count;
  }
  NormalEquations& operator+=(const NormalEquations& other) {
    matrix += other.matrix;
    vector += other.vector;
    squares += other.squares;
    cell_count += other.cell_count;
    return *this;
  }
  NormalEquations operator-(const NormalEquations& other) const {
    NormalEquations rest = *this;
    rest.matrix -= other.matrix;
    rest.vector -= other.vector;
    rest.cell_count -= other.cell_count;
    return rest;
  }
  std::optional<Vec4> solution() const {
    bool is_regular = false;
    const Mat4 inverse = matrix.inv(cv::DECOMP_CHOLESKY, &is_regular);
    if (!is_regular) return std::nullopt;
    return -(inverse * vector);
  }
};

struct Blocks {
  int side = kSmallestBlock;  // cells
  int rows = 0, cols = 0;
  std::vector<bool> is_lit;  // [row * cols + col]

  std::size_t count() const { return is_lit.size(); }
  std::size_t at(int cell_row, int cell_col) const {
    return static_cast<std::size_t>(std::min(cell_row / side, rows - 1) * cols +
                                    std::min(cell_col / side, cols - 1));
  }
};

// Blocks whose mean light is not far below the brightest ones'.
Blocks find_lit_blocks(const Picture& picture, int blocks_across, int smallest_side) {
  const int height = picture.light.height_px(), width = picture.light.width_px();
  Blocks blocks;
  blocks.side = std::max(smallest_side, width / blocks_across);
  blocks.rows = std::max(1, height / blocks.side);
  blocks.cols = std::max(1, width / blocks.side);
  const auto count = static_cast<std::size_t>(blocks.rows * blocks.cols);
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

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

enum class Outliers { kHeldDown, kCounted };

// One comparison: the two pictures, smoothed, and the fit between them.
class Fit {
 public:
  Fit(const CameraInfo& camera, const Picture& first, const Picture& second, const Blocks& blocks,
      double smoothing, double period_px)
      : blocks_(blocks),
        smoothing_(smoothing),
        first_(smoothed(first.light, smoothing)),
        mean_(local_mean(first, period_px)),
        second_(second.light),
        first_usable_(shrunk(first.is_usable, kMargin)),
        second_usable_(shrunk(second.is_usable, kMargin)) {
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

  int cell_count() const { return cell_count_; }

  // Gauss and Newton's method; false where it leaves the picture or finds no footing.
  bool descend(Parameters& at, int step_count) {
    for (int step = 0; step < step_count; ++step) {
      const auto sums = normal_equations(at);
      NormalEquations all = std::accumulate(
          sums.begin(), sums.end(), NormalEquations{},
          [](NormalEquations sum, const NormalEquations& each) { return sum += each; });
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

  // [block] at `at`; the scale for holding outliers down is learnt on the way.
  std::vector<NormalEquations> normal_equations(const Parameters& at,
                                                Outliers outliers = Outliers::kHeldDown) {
    const Image<float> moved = smoothed(second_, smoothing_, {at.row, at.col});
    std::vector<NormalEquations> sums(blocks_.count());
    std::vector<double> sizes;
    const int row_shift = static_cast<int>(std::lround(at.row));
    const int col_shift = static_cast<int>(std::lround(at.col));
    for (int row = kMargin; row < height() - kMargin; ++row) {
      for (int col = kMargin; col < width() - kMargin; ++col) {
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
        NormalEquations& block = sums[blocks_.at(row, col)];
        block.add({slope(1, 0), slope(0, 1), -light, -mean}, residual, weight / (noise * noise));
      }
    }
    typical_size_ = std::max(median(std::move(sizes)), 1e-6);
    return sums;
  }

  // Share of the first picture's variation that `at` leaves unexplained.
  double unexplained_frac(const Parameters& at) const {
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

 private:
  int height() const { return first_.height_px(); }
  int width() const { return first_.width_px(); }
  bool is_compared(int row, int col) const {
    return first_usable_.at(row, col) != 0 && blocks_.is_lit[blocks_.at(row, col)];
  }
  bool is_second_usable(int row, int col) const {
    return row >= 0 && row < height() && col >= 0 && col < width() &&
           second_usable_.at(row, col) != 0;
  }

  const Blocks& blocks_;
  const double smoothing_;  // cells
  Image<float> first_;      // smoothed
  // Its mean over a stripe or so: what skin gives back of light that comes from everywhere.
  Image<float> mean_;
  const Image<float>& second_;  // as it was taken
  Image<unsigned char> first_usable_, second_usable_;
  int cell_count_ = 0;
  double lit_dn_ = 0, shot_dn_ = 0, floor_dn2_ = 0;
  double typical_size_ = 1e30;  // of residuals, in their noise; at first none is an outlier
};

// What one block says beyond the whole: its shift across its strongest edges, and its light.
struct BlockChange {
  double shift_cells = 0, shift_sd_cells = 0;  // the whole's included
  double light_frac = 0, light_sd_frac = 0;    // beyond the whole's
};

// `variance` of a weighted residual.
std::optional<BlockChange> block_change(const NormalEquations& sums, const Parameters& whole,
                                        double variance) {
  constexpr int kFewestCells = 12;
  if (sums.cell_count < kFewestCells) return std::nullopt;
  const Mat4& m = sums.matrix;
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

// Each block by itself, against the noise of the median block: one that changed has no noise to be
// measured by.
std::vector<std::optional<BlockChange>> block_changes(const std::vector<NormalEquations>& sums,
                                                      const Parameters& whole) {
  std::vector<double> variances;
  for (const NormalEquations& block : sums)
    if (block.cell_count > 0) variances.push_back(block.squares / block.cell_count);
  const double variance = kCellsShared * median(std::move(variances));
  std::vector<std::optional<BlockChange>> changes;
  for (const NormalEquations& block : sums) changes.push_back(block_change(block, whole, variance));
  return changes;
}

// Standard deviations of the whole by leaving out one block at a time: that needs no assumption
// about how errors of neighbours hang together within a block. nullopt: there are too few.
std::optional<Vec4> jackknife_sd(const std::vector<NormalEquations>& sums,
                                 const NormalEquations& all) {
  std::vector<Vec4> answers;
  for (const NormalEquations& block : sums) {
    if (block.cell_count == 0) continue;
    if (const auto without = (all - block).solution()) answers.push_back(*without);
  }
  constexpr std::size_t kFewestAnswers = 3;
  if (answers.size() < kFewestAnswers) return std::nullopt;
  Vec4 mean{0, 0, 0, 0}, squares{0, 0, 0, 0}, sd{0, 0, 0, 0};
  const auto count = static_cast<double>(answers.size());
  for (const Vec4& answer : answers) mean += answer * (1 / count);
  for (const Vec4& answer : answers)
    for (int i = 0; i < 4; ++i) squares[i] += (answer[i] - mean[i]) * (answer[i] - mean[i]);
  for (int i = 0; i < 4; ++i) sd[i] = std::sqrt(squares[i] * (count - 1) / count);
  return sd;
}

// Blocks that changed by themselves, those that touch as one place.
std::vector<LocalChange> find_local_changes(const std::vector<std::optional<BlockChange>>& changes,
                                            const Blocks& blocks, int bin_px) {
  std::vector<double> sizes;
  int top = blocks.rows, bottom = -1;
  for (std::size_t i = 0; i < changes.size(); ++i) {
    if (!changes[i]) continue;
    sizes.push_back(std::abs(changes[i]->light_frac));
    top = std::min(top, static_cast<int>(i) / blocks.cols);
    bottom = std::max(bottom, static_cast<int>(i) / blocks.cols);
  }
  constexpr double kLeastChange = 0.03;  // of the light; less is not worth a retake
  const double usual = 1.4826 * median(std::move(sizes));
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
          const auto neighbour = static_cast<std::size_t>(r * blocks.cols + c);
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

// Root mean square of the blocks' shifts, less what their noise adds; the twentieth that moved most
// is left out, for a strand of hair is not the head.
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

tl::unexpected<InputError> cannot_compare(const std::string& why) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", why});
}

// The best of the starts: where the picture was, and where phase correlation sees it.
std::optional<Parameters> align(const CameraInfo& camera, const Picture& first,
                                const Picture& second, const Blocks& blocks, Fit& fine,
                                double period_px) {
  const CellShift coarse =
      coarse_shift(smoothed(first.light, kSmoothing), smoothed(second.light, kSmoothing));
  std::vector<CellShift> starts{{0, 0}};
  if (coarse.row != 0 || coarse.col != 0) starts.push_back(coarse);
  std::optional<Parameters> best;
  double best_frac = 0;
  for (const CellShift& start : starts) {
    Parameters at{start.row, start.col, 1, 0};
    Fit rough(camera, first, second, blocks, kCoarseSmoothing, period_px);
    constexpr int kRoughSteps = 6, kFineSteps = 12;
    if (!rough.descend(at, kRoughSteps)) at = {start.row, start.col, 1, 0};
    if (!fine.descend(at, kFineSteps)) continue;
    const double frac = fine.unexplained_frac(at);
    if (best && frac >= best_frac) continue;
    best = at;
    best_frac = frac;
  }
  return best;
}

}  // namespace

Result<FrameChange> measure_change(const CameraInfo& camera, double period_px,
                                   ImageView<const std::uint16_t> first,
                                   ImageView<const std::uint16_t> second) {
  for (const auto& frame : {first, second}) {
    if (frame.height_px != camera.height_px || frame.width_px != camera.width_px ||
        frame.channel_count != sample_channel_count(camera.pixel_format.filter))
      return tl::unexpected(InputError{InputFault::kInvalid, "", "",
                                       "a frame to compare is not of the camera's size"});
  }
  const Picture before = make_picture(camera, first), after = make_picture(camera, second);
  constexpr int kShortestSide = 2 * kMargin + kSmallestPlace;  // cells: less, and none is compared
  if (std::min(before.light.height_px(), before.light.width_px()) < kShortestSide)
    return cannot_compare("the picture is too small to compare it");
  const Blocks blocks = find_lit_blocks(before, kBlocksAcross, kSmallestBlock);
  Fit fit(camera, before, after, blocks, kSmoothing, period_px);
  constexpr int kFewestCells = 200;
  if (fit.cell_count() < kFewestCells)
    return cannot_compare("too little of the picture is lit and not clipped to compare it");
  const auto found = align(camera, before, after, blocks, fit, period_px);
  // Half of the variation unexplained: what is left is no picture of the same thing.
  constexpr double kMostUnexplainedFrac = 0.5;
  const double unexplained_frac = found ? fit.unexplained_frac(*found) : 1;
  if (!found || unexplained_frac > kMostUnexplainedFrac)
    return cannot_compare("no shift makes the two showings alike: they do not show the same");

  const auto sums = fit.normal_equations(*found);
  NormalEquations all;
  for (const NormalEquations& block : sums) all += block;
  const auto sd = jackknife_sd(sums, all);
  if (!sd) return cannot_compare("too little of the picture is lit and not clipped to compare it");
  const auto changes = block_changes(fit.normal_equations(*found, Outliers::kCounted), *found);

  FrameChange change;
  change.lit_frac =
      fit.cell_count() / static_cast<double>(before.light.height_px() * before.light.width_px());
  change.shift_row_px = found->row * before.bin_px;
  change.shift_col_px = found->col * before.bin_px;
  change.shift_row_sd_px = (*sd)[0] * before.bin_px;
  change.shift_col_sd_px = (*sd)[1] * before.bin_px;
  change.local_shift_px = rms_shift_cells(changes) * before.bin_px;
  change.light_frac = found->gain - 1;
  change.light_sd_frac = (*sd)[2];
  change.ambient_frac = found->ambient;
  change.ambient_sd_frac = (*sd)[3];
  change.residual_frac = unexplained_frac;
  const Blocks places = find_lit_blocks(before, kPlacesAcross, kSmallestPlace);
  Fit at_places(camera, before, after, places, kSmoothing, period_px);
  change.local_changes = find_local_changes(
      block_changes(at_places.normal_equations(*found, Outliers::kCounted), *found), places,
      before.bin_px);
  return change;
}

}  // namespace estimation
