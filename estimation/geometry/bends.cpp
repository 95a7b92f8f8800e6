#include "estimation/geometry/bends.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace estimation {
namespace {

// Window samples on either side of a node: its bends are smooth over the window.
constexpr int kWindowSamples = 4;
constexpr std::size_t kLeastSamples = 20;

// Derivatives of position and normal by the picture's columns and rows, by weighted least squares.
struct Slopes {
  Vec3 position_by_col_mm, position_by_row_mm, normal_by_col, normal_by_row;
};

// Weights of the window's samples, `step_px` apart.
class SlopeWindow {
 public:
  explicit SlopeWindow(int radius_px)
      : radius_px_(radius_px), step_px_(std::max(1, radius_px / kWindowSamples)) {
    for (int d = -radius_px_; d <= radius_px_; d += step_px_) {
      offsets_px_.push_back(d);
      weights_.push_back(std::exp(-2.0 * d * d / (radius_px * radius_px)));
    }
  }

  // Of position and normal around a pixel that has them.
  std::optional<Slopes> fit(const Surface& surface, int row, int col) const {
    using Terms = std::array<double, 3>;  // of 1, dx, dy
    Terms ones{}, columns{}, rows{};      // the normal matrix
    std::array<Terms, 6> right{};         // [X, Y, Z of position and normal]
    std::size_t count = 0;
    const double depth_mm = double{surface.position_mm[2].at(row, col)};
    for (std::size_t j = 0; j < offsets_px_.size(); ++j) {
      const int r = row + offsets_px_[j];
      if (r < 0 || r >= surface.validity.height_px()) continue;
      for (std::size_t i = 0; i < offsets_px_.size(); ++i) {
        const int c = col + offsets_px_[i];
        if (c < 0 || c >= surface.validity.width_px()) continue;
        if (std::isnan(surface.position_mm[2].at(r, c))) continue;
        const double w = weights_[i] * weights_[j];
        const double wx = w * offsets_px_[i], wy = w * offsets_px_[j];
        const auto add = [&](Terms& terms, double value) {
          terms[0] += w * value;
          terms[1] += wx * value;
          terms[2] += wy * value;
        };
        add(ones, 1);
        add(columns, offsets_px_[i]);
        add(rows, offsets_px_[j]);
        add(right[0], double{surface.position_mm[0].at(r, c)});
        add(right[1], double{surface.position_mm[1].at(r, c)});
        add(right[2], double{surface.position_mm[2].at(r, c)} - depth_mm);
        for (std::size_t k = 0; k < 3; ++k) add(right[k + 3], double{surface.normal[k].at(r, c)});
        ++count;
      }
    }
    if (count < kLeastSamples) return std::nullopt;
    const cv::Matx33d normal_matrix(ones[0], ones[1], ones[2], columns[0], columns[1], columns[2],
                                    rows[0], rows[1], rows[2]);
    bool is_regular = false;
    const cv::Matx33d inverse = normal_matrix.inv(cv::DECOMP_CHOLESKY, &is_regular);
    if (!is_regular) return std::nullopt;
    const auto slope = [&](int term, std::size_t of) {
      return inverse(term, 0) * right[of][0] + inverse(term, 1) * right[of][1] +
             inverse(term, 2) * right[of][2];
    };
    return Slopes{{slope(1, 0), slope(1, 1), slope(1, 2)},
                  {slope(2, 0), slope(2, 1), slope(2, 2)},
                  {slope(1, 3), slope(1, 4), slope(1, 5)},
                  {slope(2, 3), slope(2, 4), slope(2, 5)}};
  }

 private:
  int radius_px_, step_px_;
  std::vector<int> offsets_px_;
  std::vector<double> weights_;
};

class BendFinder {
 public:
  BendFinder(const Stereo& stereo, const Surface& surface, Axis axis, int radius_px)
      : stereo_(stereo), surface_(surface), axis_(axis), window_(radius_px) {}

  Bend at(int row, int col) const {
    const Vec3 here_mm = vector_at(surface_.position_mm, row, col);
    if (!std::isfinite(here_mm[2])) return {};
    const auto slopes = window_.fit(surface_, row, col);
    if (!slopes) return {};
    const Vec3 normal = vector_at(surface_.normal, row, col);
    const auto gradient = gradient_at(here_mm);
    if (!gradient) return {};
    const Vec3 tangential = *gradient - normal.dot(*gradient) * normal;
    const double length = cv::norm(tangential);
    if (!(length > 0)) return {};
    const Vec3 along = tangential / length, across = normal.cross(along);
    const auto bend_along = normal_change(*slopes, along);
    const auto bend_across = normal_change(*slopes, across);
    if (!bend_along || !bend_across) return {};
    const Vec3 to_projector = stereo_.projector_centre_mm() - here_mm;
    const double distance_mm = cv::norm(to_projector);
    const Vec3 towards = to_projector / distance_mm;
    // The cosine changes as the normal turns and as the direction does; the square law adds two.
    const double light_per_mm =
        bend_along->dot(towards) / normal.dot(towards) + 3 * along.dot(towards) / distance_mm;
    const double out = normal.dot(*gradient);
    const auto second = [&](const Vec3& way, const Vec3& turn) {
      return straight_second(here_mm, way) - out * way.dot(turn);
    };
    return {1,
            static_cast<float>(length),
            static_cast<float>(light_per_mm),
            static_cast<float>(second(along, *bend_along)),
            static_cast<float>(second(across, *bend_across)),
            static_cast<float>(length * along.dot(towards)),
            static_cast<float>(-length * along.dot(here_mm) / cv::norm(here_mm))};
  }

 private:
  std::optional<Vec3> gradient_at(const Vec3& point_mm) const {
    const auto lit = stereo_.project(point_mm);
    if (!lit) return std::nullopt;
    return axis_ == Axis::kColumn ? lit->column_gradient_px_per_mm : lit->row_gradient_px_per_mm;
  }

  // Of the coordinate along a straight line: perspective and lens.
  double straight_second(const Vec3& point_mm, const Vec3& way) const {
    constexpr double kStepMm = 1;
    const auto before = gradient_at(point_mm - kStepMm * way);
    const auto after = gradient_at(point_mm + kStepMm * way);
    return before && after ? way.dot(*after - *before) / (2 * kStepMm) : 0;
  }

  // Of the normal by mm along a tangent: the tangent as so many columns and rows, by least squares.
  static std::optional<Vec3> normal_change(const Slopes& slopes, const Vec3& way) {
    const Vec3 &x = slopes.position_by_col_mm, &y = slopes.position_by_row_mm;
    const double xx = x.dot(x), xy = x.dot(y), yy = y.dot(y);
    const double determinant = xx * yy - xy * xy;
    if (!(determinant > 1e-6 * xx * yy)) return std::nullopt;
    const double wx = way.dot(x), wy = way.dot(y);
    const double columns = (yy * wx - xy * wy) / determinant;
    const double rows = (xx * wy - xy * wx) / determinant;
    return columns * slopes.normal_by_col + rows * slopes.normal_by_row;
  }

  const Stereo& stereo_;
  const Surface& surface_;
  Axis axis_;
  SlopeWindow window_;
};

}  // namespace

Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col) {
  return {double{image[0].at(row, col)}, double{image[1].at(row, col)},
          double{image[2].at(row, col)}};
}

Bend BendNodes::at(int row, int col) const {
  const double y = (row + 0.5) / side_px - 0.5, x = (col + 0.5) / side_px - 0.5;
  const int top = static_cast<int>(std::floor(y)), left = static_cast<int>(std::floor(x));
  Bend sum;
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j) {
      const int r = top + i, c = left + j;
      if (r < 0 || c < 0 || r >= rows || c >= cols) continue;
      const Bend& bend = node(r, c);
      const double wy = i == 0 ? 1 - (y - top) : y - top, wx = j == 0 ? 1 - (x - left) : x - left;
      const auto weight = static_cast<float>(wx * wy) * bend.is_known;
      sum.is_known += weight;
      sum.gradient_px_per_mm += weight * bend.gradient_px_per_mm;
      sum.light_per_mm += weight * bend.light_per_mm;
      sum.along_px_per_mm2 += weight * bend.along_px_per_mm2;
      sum.across_px_per_mm2 += weight * bend.across_px_per_mm2;
    }
  if (!(sum.is_known > 0.01F)) return {};
  const float scale = 1 / sum.is_known;
  return {1, sum.gradient_px_per_mm * scale, sum.light_per_mm * scale, sum.along_px_per_mm2 * scale,
          sum.across_px_per_mm2 * scale};
}

BendNodes bends_of(const Stereo& stereo, const Surface& surface, Axis axis, int radius_px,
                   int side_px) {
  BendNodes found;
  found.side_px = side_px;
  found.rows = (surface.validity.height_px() + side_px - 1) / side_px;
  found.cols = (surface.validity.width_px() + side_px - 1) / side_px;
  found.nodes.resize(static_cast<std::size_t>(found.rows) * static_cast<std::size_t>(found.cols));
  const BendFinder finder(stereo, surface, axis, radius_px);
  tbb::parallel_for(0, found.rows, [&](int i) {
    for (int j = 0; j < found.cols; ++j) {
      const int row = std::min(i * side_px + side_px / 2, surface.validity.height_px() - 1);
      const int col = std::min(j * side_px + side_px / 2, surface.validity.width_px() - 1);
      found.nodes[static_cast<std::size_t>(i) * static_cast<std::size_t>(found.cols) +
                  static_cast<std::size_t>(j)] = finder.at(row, col);
    }
  });
  return found;
}

}  // namespace estimation
