#include "estimation/geometry/smoothing.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <opencv2/core.hpp>
#include <vector>

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
// Depths of neighbours differ by noise of this many standard deviations before it is a jump.
constexpr float kJumpSd = 5;
// Beside a border the window is sampled this many times on either side.
constexpr int kSparseRadius = 4;
constexpr int kMinQuadricPoints = 15;
constexpr int kMinPlanePoints = 4;
constexpr int kRowsPerBand = 64;
// More missing neighbours than this are a border, fewer are dropped pixels.
constexpr double kBorderFrac = 0.1;

// Sums over any rectangle in constant time.
class SumTable {
 public:
  explicit SumTable(const Image<unsigned char>& image)
      : sums_(image.height_px() + 1, image.width_px() + 1) {
    for (int row = 0; row < image.height_px(); ++row) {
      std::int32_t line = 0;
      for (int col = 0; col < image.width_px(); ++col) {
        line += image.at(row, col);
        sums_.at(row + 1, col + 1) = sums_.at(row, col + 1) + line;
      }
    }
  }

  // Within the image, `radius` around (row, col).
  std::int32_t around(int row, int col, int radius) const {
    const int top = std::max(row - radius, 0), left = std::max(col - radius, 0);
    const int bottom = std::min(row + radius + 1, sums_.height_px() - 1);
    const int right = std::min(col + radius + 1, sums_.width_px() - 1);
    return sums_.at(bottom, right) - sums_.at(top, right) - sums_.at(bottom, left) +
           sums_.at(top, left);
  }

 private:
  Image<std::int32_t> sums_;
};

template <typename Body>
void for_rows(int height_px, std::size_t grain, const Body& body) {
  oneapi::tbb::parallel_for(oneapi::tbb::blocked_range<int>(0, height_px, grain),
                            [&](const oneapi::tbb::blocked_range<int>& range) {
                              for (int row = range.begin(); row < range.end(); ++row) body(row);
                            });
}

struct Neighbours {
  const DepthMap& depth;
  float max_relative_step;

  // Two points `distance_px` apart lie on one surface. False if one of them is missing.
  bool are_linked(int row, int col, int other_row, int other_col, int distance_px) const {
    const float a = depth.inverse_depth_per_mm.at(row, col);
    const float b = depth.inverse_depth_per_mm.at(other_row, other_col);
    const float noise =
        std::hypot(depth.relative_sd.at(row, col), depth.relative_sd.at(other_row, other_col));
    const float limit = max_relative_step * static_cast<float>(distance_px) + kJumpSd * noise;
    return std::abs(a - b) <= limit * std::min(a, b);
  }
};

// The inverse depth with single missing pixels filled from their neighbours, minus an offset that
// keeps float sums exact; marks what is still missing and where neighbours jump.
struct Prepared {
  Image<float> offset_inverse;
  float offset = 0;
  Image<unsigned char> is_missing, is_jump;
};

float median_of(ImageView<const float> image) {
  std::vector<float> values;
  for (int row = 0; row < image.height_px; ++row) {
    for (int col = row % 4; col < image.width_px; col += 4) {
      if (!std::isnan(image.at(row, col))) values.push_back(image.at(row, col));
    }
  }
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Mean of the neighbours if at least six of eight are there and all agree, else NaN.
float fill_from_neighbours(ImageView<const float> inverse, const Neighbours& neighbours, int row,
                           int col) {
  if (row < 1 || col < 1 || row + 1 >= inverse.height_px || col + 1 >= inverse.width_px) {
    return kNaN;
  }
  float sum = 0, count = 0, low = std::numeric_limits<float>::infinity(), high = 0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const float value = inverse.at(row + dy, col + dx);
      if (std::isnan(value)) continue;
      sum += value;
      ++count;
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  const bool agree = high - low <= 3 * neighbours.max_relative_step * low;
  return count >= 6 && agree ? sum / count : kNaN;
}

Prepared prepare(const DepthMap& depth, const Neighbours& neighbours) {
  const ImageView<const float> inverse = depth.inverse_depth_per_mm;
  const int height = inverse.height_px, width = inverse.width_px;
  Prepared out{Image<float>(height, width), median_of(inverse), Image<unsigned char>(height, width),
               Image<unsigned char>(height, width)};
  for_rows(height, 16, [&](int row) {
    for (int col = 0; col < width; ++col) {
      float value = inverse.at(row, col);
      if (std::isnan(value)) value = fill_from_neighbours(inverse, neighbours, row, col);
      const bool is_missing = std::isnan(value);
      out.is_missing.at(row, col) = is_missing;
      out.offset_inverse.at(row, col) = is_missing ? 0 : value - out.offset;
      if (std::isnan(inverse.at(row, col))) continue;
      const auto jumps_to = [&](int r, int c) {
        return r < height && c < width && r >= 0 && c >= 0 && !std::isnan(inverse.at(r, c)) &&
               !neighbours.are_linked(row, col, r, c, 1);
      };
      out.is_jump.at(row, col) = jumps_to(row, col + 1) || jumps_to(row + 1, col) ||
                                 jumps_to(row, col - 1) || jumps_to(row - 1, col);
    }
  });
  return out;
}

// --- full windows: the fit is a fixed, separable filter -----------------------------------------

// For window offsets x, y and Gaussian weights g: value = sum g(x) g(y) (a + b (x^2 + y^2)) q,
// slopes = sum g(x) g(y) s x q and s y q (Savitzky-Golay with a weight).
struct FilterKernels {
  int radius = 0;
  std::vector<float> plain, first, second;  // g, g x, g x^2; [offset + radius]
  float a = 0, b = 0, s = 0;
  float noise_gain = 0, slope_gain = 0;
};

FilterKernels make_kernels(int radius_px) {
  FilterKernels kernels;
  kernels.radius = radius_px;
  double m0 = 0, m2 = 0, m4 = 0;
  std::vector<double> weights;
  for (int x = -radius_px; x <= radius_px; ++x) {
    const double g = std::exp(-2.0 * x * x / (radius_px * radius_px));
    weights.push_back(g);
    kernels.plain.push_back(static_cast<float>(g));
    kernels.first.push_back(static_cast<float>(g * x));
    kernels.second.push_back(static_cast<float>(g * x * x));
    m0 += g;
    m2 += g * x * x;
    m4 += g * x * x * x * x;
  }
  // Normal equations of 1, x^2, y^2 by symmetry of x and y: value = a M00 + b (M20 + M02).
  const double determinant = m0 * m0 * (m4 * m0 + m2 * m2) - 2 * m2 * m0 * m2 * m0;
  const double a = (m4 * m0 + m2 * m2) / determinant;
  const double b = -m2 * m0 / determinant;
  const double* weight_at = weights.data() + radius_px;  // [-radius_px ... radius_px]
  double squares = 0, slope_squares = 0;
  for (int y = -radius_px; y <= radius_px; ++y) {
    for (int x = -radius_px; x <= radius_px; ++x) {
      const double h = weight_at[x] * weight_at[y] * (a + b * (x * x + y * y));
      squares += h * h;
      slope_squares += std::pow(weight_at[x] * weight_at[y] * x / (m0 * m2), 2);
    }
  }
  kernels.a = static_cast<float>(a);
  kernels.b = static_cast<float>(b);
  kernels.s = static_cast<float>(1 / (m0 * m2));
  kernels.noise_gain = static_cast<float>(std::sqrt(squares));
  kernels.slope_gain = static_cast<float>(std::sqrt(slope_squares));
  return kernels;
}

using Row = std::vector<float>;

void add_scaled(std::span<const float> from, float factor, Row& to) {
  for (std::size_t i = 0; i < to.size(); ++i) to[i] += factor * from[i];
}

// One image row filtered along x by the three kernels; columns nearer than radius to the border
// are left zero.
struct FilteredRow {
  Row plain, first, second;
};

FilteredRow filter_along_row(std::span<const float> samples, const FilterKernels& kernels) {
  const std::size_t width = samples.size();
  const auto radius = static_cast<std::size_t>(kernels.radius);
  FilteredRow out{Row(width), Row(width), Row(width)};
  if (width < 2 * radius + 1) return out;
  const std::size_t inner = width - 2 * radius;
  for (std::size_t k = 0; k < kernels.plain.size(); ++k) {
    const float plain = kernels.plain[k], first = kernels.first[k], second = kernels.second[k];
    for (std::size_t i = 0; i < inner; ++i) {
      const float sample = samples[i + k];
      out.plain[i + radius] += plain * sample;
      out.first[i + radius] += first * sample;
      out.second[i + radius] += second * sample;
    }
  }
  return out;
}

void filter_band(const Prepared& prepared, const FilterKernels& kernels, int begin, int end,
                 LocalFit& fit) {
  const int radius = kernels.radius;
  const ImageView<const float> image = prepared.offset_inverse.view();
  begin = std::max(begin, radius);
  end = std::min(end, image.height_px - radius);
  if (begin >= end) return;
  std::vector<FilteredRow> filtered;
  for (int row = begin - radius; row < end + radius; ++row) {
    filtered.push_back(filter_along_row(image.row(row), kernels));
  }
  const auto width = static_cast<std::size_t>(image.width_px);
  for (int row = begin; row < end; ++row) {
    Row value(width), by_col(width), by_row(width);
    for (std::size_t k = 0; k < kernels.plain.size(); ++k) {
      const FilteredRow& line = filtered[static_cast<std::size_t>(row - begin) + k];
      add_scaled(line.plain, kernels.a * kernels.plain[k] + kernels.b * kernels.second[k], value);
      add_scaled(line.second, kernels.b * kernels.plain[k], value);
      add_scaled(line.first, kernels.s * kernels.plain[k], by_col);
      add_scaled(line.plain, kernels.s * kernels.first[k], by_row);
    }
    for (std::size_t col = 0; col < width; ++col) {
      const int c = static_cast<int>(col);
      fit.inverse_depth_per_mm.at(row, c) = value[col] + prepared.offset;
      fit.by_col.at(row, c) = by_col[col];
      fit.by_row.at(row, c) = by_row[col];
      fit.noise_gain.at(row, c) = kernels.noise_gain;
      fit.slope_gain.at(row, c) = kernels.slope_gain;
    }
  }
}

// --- beside borders and jumps: least squares over the connected neighbours ----------------------

struct FitPoint {
  double x = 0, y = 0, inverse = 0, weight = 0;
};

constexpr int kSparseSize = 2 * kSparseRadius + 1;
constexpr std::size_t kSparseCount = std::size_t{kSparseSize} * kSparseSize;

// The neighbours that links lead to from the centre, on a grid of `stride` px.
std::vector<FitPoint> connected_points(const DepthMap& depth, const Neighbours& neighbours, int row,
                                       int col, int stride, int radius_px) {
  std::array<char, kSparseCount> seen{};
  std::vector<std::array<int, 2>> queue{{0, 0}};
  std::vector<FitPoint> points;
  seen[kSparseCount / 2] = 1;
  for (std::size_t next = 0; next < queue.size(); ++next) {
    const auto [gy, gx] = queue[next];
    const int y = row + gy * stride, x = col + gx * stride;
    const double distance2 = double(gx * gx + gy * gy) * stride * stride;
    points.push_back({double(gx) * stride, double(gy) * stride,
                      double{depth.inverse_depth_per_mm.at(y, x)},
                      std::exp(-2 * distance2 / (radius_px * radius_px))});
    for (const auto& [dy, dx] : {std::array{0, 1}, {1, 0}, {0, -1}, {-1, 0}}) {
      const int ny = gy + dy, nx = gx + dx;
      if (std::max(std::abs(ny), std::abs(nx)) * stride > radius_px) continue;
      const int cell = (ny + kSparseRadius) * kSparseSize + nx + kSparseRadius;
      char& was_seen = seen[static_cast<std::size_t>(cell)];
      const int other_y = row + ny * stride, other_x = col + nx * stride;
      if (was_seen || other_y < 0 || other_x < 0 ||
          other_y >= depth.inverse_depth_per_mm.height_px ||
          other_x >= depth.inverse_depth_per_mm.width_px ||
          !neighbours.are_linked(y, x, other_y, other_x, stride)) {
        continue;
      }
      was_seen = 1;
      queue.push_back({ny, nx});
    }
  }
  return points;
}

struct PointFit {
  double value = 0, by_x = 0, by_y = 0, noise_gain = 0, slope_gain = 0;
  bool is_valid = false;
};

// Weighted least squares over 1, x, y (and x^2, xy, y^2), coordinates in units of `scale`.
template <int kTerms>
PointFit fit_polynomial(const std::vector<FitPoint>& points, double scale) {
  using Vector = cv::Vec<double, kTerms>;
  const auto basis = [&](const FitPoint& point) {
    const double x = point.x / scale, y = point.y / scale;
    const std::array<double, 6> all{1, x, y, x * x, x * y, y * y};
    Vector terms;
    for (int i = 0; i < kTerms; ++i) terms[i] = all[static_cast<std::size_t>(i)];
    return terms;
  };
  cv::Matx<double, kTerms, kTerms> normal;
  Vector right;
  for (const FitPoint& point : points) {
    const Vector terms = basis(point);
    normal += point.weight * (terms * terms.t());
    right += point.weight * (point.inverse - points.front().inverse) * terms;
  }
  bool is_regular = false;
  const cv::Matx<double, kTerms, kTerms> inverse = normal.inv(cv::DECOMP_CHOLESKY, &is_regular);
  const Vector solution = inverse * right;
  PointFit fit{.value = points.front().inverse + solution[0],
               .by_x = solution[1] / scale,
               .by_y = solution[2] / scale,
               .is_valid = is_regular};
  Vector squares;  // of what a point does to each coefficient
  for (const FitPoint& point : points) {
    const Vector influence = point.weight * (inverse * basis(point));
    squares += influence.mul(influence);
  }
  fit.noise_gain = std::sqrt(squares[0]);
  fit.slope_gain = std::sqrt((squares[1] + squares[2]) / 2) / scale;
  // A centre that extrapolates more than it averages is no fit.
  fit.is_valid = fit.is_valid && fit.noise_gain <= 1 && std::isfinite(fit.value);
  return fit;
}

PointFit fit_connected(const DepthMap& depth, const Neighbours& neighbours, int row, int col,
                       int radius_px) {
  const int stride = (radius_px + kSparseRadius - 1) / kSparseRadius;
  const auto points = connected_points(depth, neighbours, row, col, stride, radius_px);
  PointFit fit;
  if (points.size() >= kMinQuadricPoints) fit = fit_polynomial<6>(points, radius_px);
  if (!fit.is_valid && points.size() >= kMinPlanePoints) {
    fit = fit_polynomial<3>(points, radius_px);
  }
  return fit;
}

void store(const PointFit& fit, int row, int col, LocalFit& out) {
  out.inverse_depth_per_mm.at(row, col) = fit.is_valid ? static_cast<float>(fit.value) : kNaN;
  out.by_col.at(row, col) = fit.is_valid ? static_cast<float>(fit.by_x) : kNaN;
  out.by_row.at(row, col) = fit.is_valid ? static_cast<float>(fit.by_y) : kNaN;
  out.noise_gain.at(row, col) = fit.is_valid ? static_cast<float>(fit.noise_gain) : kNaN;
  out.slope_gain.at(row, col) = fit.is_valid ? static_cast<float>(fit.slope_gain) : kNaN;
}

}  // namespace

LocalFit fit_locally(const DepthMap& depth, const FitOptions& options) {
  const int height = depth.inverse_depth_per_mm.height_px;
  const int width = depth.inverse_depth_per_mm.width_px;
  const Neighbours neighbours{depth, static_cast<float>(options.max_relative_step)};
  const Prepared prepared = prepare(depth, neighbours);
  const SumTable missing(prepared.is_missing), jumps(prepared.is_jump);
  LocalFit fit;
  for (Image<float>* image :
       {&fit.inverse_depth_per_mm, &fit.by_col, &fit.by_row, &fit.noise_gain, &fit.slope_gain}) {
    *image = Image<float>(height, width, 1, kNaN);
  }
  fit.is_near_discontinuity = Image<unsigned char>(height, width);

  const FilterKernels kernels = make_kernels(options.radius_px);
  const int band_count = (height + kRowsPerBand - 1) / kRowsPerBand;
  for_rows(band_count, 1, [&](int band) {
    filter_band(prepared, kernels, band * kRowsPerBand, std::min((band + 1) * kRowsPerBand, height),
                fit);
  });

  const int radius = options.radius_px, near_radius = options.discontinuity_radius_px;
  const double border_count = kBorderFrac * std::pow(2 * near_radius + 1, 2);
  for_rows(height, 4, [&](int row) {
    for (int col = 0; col < width; ++col) {
      if (std::isnan(depth.inverse_depth_per_mm.at(row, col))) {
        store({}, row, col, fit);
        continue;
      }
      const bool is_full = row >= radius && col >= radius && row + radius < height &&
                           col + radius < width && missing.around(row, col, radius) == 0 &&
                           jumps.around(row, col, radius) == 0;
      if (!is_full) store(fit_connected(depth, neighbours, row, col, radius), row, col, fit);
      fit.is_near_discontinuity.at(row, col) = jumps.around(row, col, near_radius) > 0 ||
                                               missing.around(row, col, near_radius) > border_count;
    }
  });
  return fit;
}

}  // namespace estimation
