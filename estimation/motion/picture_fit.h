// Two pictures of one thing fitted to each other: shift, gain and ambient light together, by
// weighted least squares on the smoothed pictures, outliers held down. Private to
// estimation/motion.
#pragma once

#include <algorithm>
#include <cstddef>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "estimation/motion/picture.h"

namespace estimation {

// Cells: enough to make noise and gradients smooth, little against a stripe (some 20 cells).
inline constexpr double kFineSmoothing = 1.0, kCoarseSmoothing = 4.0;
inline constexpr int kFitMargin = 2;  // cells that smoothing and interpolation reach

// Of the second picture to the first.
struct Alignment {
  double row = 0, col = 0;       // cells
  double gain = 1, ambient = 0;  // of the first showing's light, and of its local mean
};

// Sums over some cells for r + J x: x = changes of row, col, gain, ambient.
struct AlignmentSums {
  cv::Matx44d matrix = cv::Matx44d::zeros();
  cv::Vec4d vector{0, 0, 0, 0};  // J^T w r
  double squares = 0;            // w r^2
  int cell_count = 0;

  void add(const cv::Vec4d& gradient, double residual, double weight) {
    for (int i = 0; i < 4; ++i) {
      vector[i] += weight * gradient[i] * residual;
      for (int k = 0; k < 4; ++k) matrix(i, k) += weight * gradient[i] * gradient[k];
    }
    squares += weight * residual * residual;
    ++cell_count;
  }
  AlignmentSums& operator+=(const AlignmentSums& other) {
    matrix += other.matrix;
    vector += other.vector;
    squares += other.squares;
    cell_count += other.cell_count;
    return *this;
  }
  AlignmentSums operator-(const AlignmentSums& other) const {
    AlignmentSums rest = *this;
    rest.matrix -= other.matrix;
    rest.vector -= other.vector;
    rest.cell_count -= other.cell_count;
    return rest;
  }
  std::optional<cv::Vec4d> solution() const {
    bool is_regular = false;
    const cv::Matx44d inverse = matrix.inv(cv::DECOMP_CHOLESKY, &is_regular);
    if (!is_regular) return std::nullopt;
    return -(inverse * vector);
  }
};

// The picture in squares, and which of them are lit.
struct PictureBlocks {
  int side = 1;  // cells
  int rows = 0, cols = 0;
  std::vector<bool> is_lit;  // [row * cols + col]

  std::size_t count() const { return is_lit.size(); }
  std::size_t at(int cell_row, int cell_col) const {
    return static_cast<std::size_t>(std::min(cell_row / side, rows - 1) * cols +
                                    std::min(cell_col / side, cols - 1));
  }
};

// Lit are those whose mean light is not far below the brightest ones'. At most `blocks_across` in a
// row, each of at least `smallest_side` cells.
PictureBlocks find_lit_blocks(const Picture& picture, int blocks_across, int smallest_side);

enum class Outliers { kHeldDown, kCounted };

// One comparison: the two pictures, smoothed, and the fit between them. `second` and `blocks`
// outlive it.
class PictureFit {
 public:
  PictureFit(const CameraInfo& camera, const Picture& first, const Picture& second,
             const PictureBlocks& blocks, double smoothing, double period_px);

  int cell_count() const { return cell_count_; }  // that are lit, and not clipped in the first

  // Gauss and Newton's method; false where it leaves the picture or finds no footing.
  bool descend(Alignment& at, int step_count);
  // [block] at `at`; the scale for holding outliers down is learnt on the way.
  std::vector<AlignmentSums> normal_equations(const Alignment& at,
                                              Outliers outliers = Outliers::kHeldDown);
  // Share of the first picture's variation that `at` leaves unexplained.
  double unexplained_frac(const Alignment& at) const;

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

  const PictureBlocks& blocks_;
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

}  // namespace estimation
