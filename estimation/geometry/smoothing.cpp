#include "estimation/geometry/smoothing.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "estimation/geometry/connected_fit.h"
#include "estimation/geometry/edge_slopes.h"
#include "estimation/geometry/filter_rows.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr int kRowsPerBand = 32;
// More missing neighbours than this are a border, fewer are dropped pixels.
constexpr double kBorderFrac = 0.1;

// --- what is missing and where the depth jumps --------------------------------------------------

// How many marks lie within `radius` of a row's pixels, rows taken one after the other.
class BoxCount {
 public:
  BoxCount(const Image<unsigned char>& marks, int radius, int first_row)
      : marks_(marks),
        radius_(radius),
        columns_(static_cast<std::size_t>(marks.width_px())),
        sums_(columns_.size() + 1) {
    for (int row = first_row - radius - 1; row < first_row + radius; ++row) add(row, 1);
  }

  // To be called for the first row, the next one, and so on.
  void enter(int row) {
    add(row + radius_, 1);
    add(row - radius_ - 1, -1);
    std::int32_t sum = 0;
    for (std::size_t col = 0; col < columns_.size(); ++col) sums_[col + 1] = sum += columns_[col];
  }

  std::int32_t around(int col) const {
    const int left = std::max(col - radius_, 0);
    const int right = std::min(col + radius_ + 1, marks_.width_px());
    return sums_[static_cast<std::size_t>(right)] - sums_[static_cast<std::size_t>(left)];
  }

 private:
  void add(int row, std::int32_t sign) {
    if (row < 0 || row >= marks_.height_px()) return;
    const std::span<const unsigned char> marks = marks_.view().row(row);
    for (std::size_t col = 0; col < columns_.size(); ++col) columns_[col] += sign * marks[col];
  }

  const Image<unsigned char>& marks_;
  int radius_;
  std::vector<std::int32_t> columns_, sums_;
};

// The inverse depth with single missing pixels filled from their neighbours, minus an offset that
// keeps float sums exact; marks what is still missing and where neighbours jump.
struct Prepared {
  Image<float> offset_inverse;
  float offset = 0;
  Image<unsigned char> is_missing, is_jump;
  Image<unsigned char> is_broken;  // either
};

float median_of(ImageView<const float> image) {
  std::vector<float> values;
  for (int row = 0; row < image.height_px; row += 2) {
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

void prepare_row(ImageView<const float> inverse, const Neighbours& neighbours, int row,
                 Prepared& out) {
  const int height = inverse.height_px, width = inverse.width_px;
  for (int col = 0; col < width; ++col) {
    float value = inverse.at(row, col);
    const bool is_decoded = !std::isnan(value);
    if (!is_decoded) value = fill_from_neighbours(inverse, neighbours, row, col);
    const bool is_missing = std::isnan(value);
    const auto jumps_to = [&](int r, int c) {
      return r < height && c < width && r >= 0 && c >= 0 && !std::isnan(inverse.at(r, c)) &&
             !neighbours.are_linked(row, col, r, c, 1);
    };
    const bool is_jump = is_decoded && (jumps_to(row, col + 1) || jumps_to(row + 1, col) ||
                                        jumps_to(row, col - 1) || jumps_to(row - 1, col));
    out.offset_inverse.at(row, col) = is_missing ? 0 : value - out.offset;
    out.is_missing.at(row, col) = is_missing;
    out.is_jump.at(row, col) = is_jump;
    out.is_broken.at(row, col) = is_missing || is_jump;
  }
}

Prepared prepare(const DepthMap& depth, const Neighbours& neighbours) {
  const ImageView<const float> inverse = depth.inverse_depth_per_mm;
  const int height = inverse.height_px, width = inverse.width_px;
  Prepared out{Image<float>(height, width), median_of(inverse), Image<unsigned char>(height, width),
               Image<unsigned char>(height, width), Image<unsigned char>(height, width)};
  const auto rows = oneapi::tbb::blocked_range<int>(0, height, 16);
  oneapi::tbb::parallel_for(rows, [&](const oneapi::tbb::blocked_range<int>& range) {
    for (int row = range.begin(); row < range.end(); ++row)
      prepare_row(inverse, neighbours, row, out);
  });
  return out;
}

// --- full windows: the fit is a fixed, separable filter -----------------------------------------

struct WindowFilter {
  std::vector<float> plain, first, second;
  float a = 0, b = 0, s = 0;
  float noise_gain = 0, slope_gain = 0;
  int radius = 0;

  FilterKernels kernels() const { return {radius, plain, first, second, a, b, s}; }
};

WindowFilter make_filter(int radius_px) {
  WindowFilter filter;
  filter.radius = radius_px;
  double m0 = 0, m2 = 0, m4 = 0;
  std::vector<double> weights;
  for (int x = -radius_px; x <= radius_px; ++x) {
    const double g = std::exp(-2.0 * x * x / (radius_px * radius_px));
    weights.push_back(g);
    filter.plain.push_back(static_cast<float>(g));
    filter.first.push_back(static_cast<float>(g * x));
    filter.second.push_back(static_cast<float>(g * x * x));
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
  filter.a = static_cast<float>(a);
  filter.b = static_cast<float>(b);
  filter.s = static_cast<float>(1 / (m0 * m2));
  filter.noise_gain = static_cast<float>(std::sqrt(squares));
  filter.slope_gain = static_cast<float>(std::sqrt(slope_squares));
  return filter;
}

// Where no window is wanted the camera is coarse beside the surface's bends, and noise is not what
// limits a normal: slopes by the five points of a row or a column, exact for cubics, and the point
// where it was seen. A plain difference is off by a sixth of the third derivative, at 50
// degrees on a sphere of 100 mm seen at 4.7 mm a pixel by 0.4 degrees, which is 2% of sigma_a.
WindowFilter make_coarse_filter() {
  WindowFilter filter;
  filter.radius = 2;
  filter.plain = {0, 0, 1, 0, 0};
  filter.first = {1.0F / 12, -8.0F / 12, 0, 8.0F / 12, -1.0F / 12};
  filter.second = {0, 0, 0, 0, 0};
  filter.a = filter.s = filter.noise_gain = 1;
  filter.slope_gain = std::sqrt(2.0F * (1 + 64) / (12 * 12));
  return filter;
}

// --- bands of rows ------------------------------------------------------------------------------

// Columns [begin, end).
struct Span {
  std::size_t begin = 0, end = 0;
};

class Band {
 public:
  Band(const DepthMap& depth, const FitOptions& options, const Prepared& prepared,
       const WindowFilter& filter, const ConnectedFit& connected, const EdgeSlopes* edge_slopes,
       int begin, int end)
      : depth_(depth),
        radius_(options.radius_px),
        border_count_(kBorderFrac * std::pow(2 * options.discontinuity_radius_px + 1, 2)),
        prepared_(prepared),
        filter_(filter),
        connected_(connected),
        edge_slopes_(edge_slopes),
        begin_(begin),
        end_(end),
        width_(static_cast<std::size_t>(prepared.is_missing.width_px())),
        broken_(prepared.is_broken, radius_, begin),
        near_missing_(prepared.is_missing, options.discontinuity_radius_px, begin),
        near_jumps_(prepared.is_jump, options.discontinuity_radius_px, begin) {}

  void run(const std::function<void(int row, const FitRow&)>& take) {
    for (std::vector<float>* values : {&fit_.inverse_depth_per_mm, &fit_.by_col, &fit_.by_row,
                                       &fit_.noise_gain, &fit_.slope_gain})
      values->assign(width_, kNaN);
    fit_.is_near_discontinuity.assign(width_, 0);
    find_occupied();
    filter_rows();
    for (int row = begin_; row < end_; ++row) {
      if (occupied_.begin < occupied_.end) fit_row(row);
      take(row, fit_);
    }
  }

 private:
  // Columns in which the band has any depth.
  void find_occupied() {
    occupied_ = {width_, 0};
    for (int row = begin_; row < end_; ++row) {
      const auto inverse = depth_.inverse_depth_per_mm.row(row);
      std::size_t first = 0, last = width_;
      while (first < width_ && std::isnan(inverse[first])) ++first;
      while (last > first && std::isnan(inverse[last - 1])) --last;
      occupied_ = {std::min(occupied_.begin, first), std::max(occupied_.end, last)};
    }
  }

  // Where the window is within the picture.
  Span inner() const {
    const auto radius = static_cast<std::size_t>(radius_);
    if (width_ < 2 * radius + 1) return {};
    return {std::max(occupied_.begin, radius), std::min(occupied_.end, width_ - radius)};
  }

  bool has_window(int row) const {
    return row >= radius_ && row + radius_ < prepared_.is_missing.height_px();
  }

  void filter_rows() {
    const Span columns = inner();
    if (columns.begin >= columns.end) return;
    first_line_ = std::max(begin_ - radius_, 0);
    const int last = std::min(end_ + radius_, prepared_.is_missing.height_px());
    filtered_.resize(3 * width_ * static_cast<std::size_t>(last - first_line_));
    for (int row = first_line_; row < last; ++row) {
      float* plain = filtered_.data() + 3 * width_ * static_cast<std::size_t>(row - first_line_);
      lines_.push_back({plain, plain + width_, plain + 2 * width_});
      filter_along_row(prepared_.offset_inverse.view().row(row).data(), filter_.kernels(),
                       columns.begin, columns.end, lines_.back());
    }
  }

  void fit_row(int row) {
    broken_.enter(row);
    near_missing_.enter(row);
    near_jumps_.enter(row);
    const Span columns = has_window(row) ? inner() : Span{};
    if (columns.begin < columns.end) {
      const auto first = static_cast<std::size_t>(row - radius_ - first_line_);
      const auto lines =
          std::span(lines_).subspan(first, 2 * static_cast<std::size_t>(radius_) + 1);
      filter_across_rows(
          lines, filter_.kernels(), columns.begin, columns.end,
          {fit_.inverse_depth_per_mm.data(), fit_.by_col.data(), fit_.by_row.data()});
    }
    const auto inverse = depth_.inverse_depth_per_mm.row(row);
    for (std::size_t i = occupied_.begin; i < occupied_.end; ++i) {
      const int col = static_cast<int>(i);
      if (std::isnan(inverse[i])) {
        store({}, i);
        continue;
      }
      if (i >= columns.begin && i < columns.end && broken_.around(col) == 0) {
        fit_.inverse_depth_per_mm[i] += prepared_.offset;
        fit_.noise_gain[i] = filter_.noise_gain;
        fit_.slope_gain[i] = filter_.slope_gain;
      } else {
        store(connected_.at(row, col), i);
      }
      fit_.is_near_discontinuity[i] =
          near_jumps_.around(col) > 0 || near_missing_.around(col) > border_count_;
      if (edge_slopes_ != nullptr && (fit_.is_near_discontinuity[i] || broken_.around(col) > 0))
        take_edge_slopes(row, col);
    }
  }

  void take_edge_slopes(int row, int col) {
    const auto i = static_cast<std::size_t>(col);
    const PointFit fit = edge_slopes_->at(row, col,
                                          {.by_x = double{fit_.by_col[i]},
                                           .by_y = double{fit_.by_row[i]},
                                           .slope_gain = double{fit_.slope_gain[i]},
                                           .is_valid = !std::isnan(fit_.by_col[i])});
    if (!fit.is_valid) return;
    fit_.by_col[i] = static_cast<float>(fit.by_x);
    fit_.by_row[i] = static_cast<float>(fit.by_y);
    fit_.slope_gain[i] = static_cast<float>(fit.slope_gain);
  }

  void store(const PointFit& fit, std::size_t i) {
    const auto known = [&](double value) {
      return fit.is_valid ? static_cast<float>(value) : kNaN;
    };
    fit_.inverse_depth_per_mm[i] = known(fit.value);
    fit_.by_col[i] = known(fit.by_x);
    fit_.by_row[i] = known(fit.by_y);
    fit_.noise_gain[i] = known(fit.noise_gain);
    fit_.slope_gain[i] = known(fit.slope_gain);
  }

  const DepthMap& depth_;
  int radius_;
  double border_count_;
  const Prepared& prepared_;
  const WindowFilter& filter_;
  const ConnectedFit& connected_;
  const EdgeSlopes* edge_slopes_;  // where windows are too small to bend; else nullptr
  int begin_, end_;
  std::size_t width_;
  BoxCount broken_, near_missing_, near_jumps_;
  Span occupied_;
  std::vector<float> filtered_;
  std::vector<FilteredRow> lines_;  // from first_line_ on
  int first_line_ = 0;
  FitRow fit_;
};

}  // namespace

void fit_locally(const DepthMap& depth, const FitOptions& given,
                 const std::function<void(int row, const FitRow&)>& take) {
  const bool is_coarse = given.radius_px < 1;
  FitOptions options = given;
  if (is_coarse) options.radius_px = 2;
  const int height = depth.inverse_depth_per_mm.height_px;
  const Neighbours neighbours{depth, static_cast<float>(options.max_relative_step)};
  const Prepared prepared = prepare(depth, neighbours);
  const WindowFilter filter = is_coarse ? make_coarse_filter() : make_filter(options.radius_px);
  const ConnectedFit connected(neighbours, std::max(given.radius_px, 1));
  // Of a window of 3 x 3 points that lost some a plane is left.
  const EdgeSlopes edge_slopes(neighbours);
  const bool is_small = given.radius_px <= 1;
  const int band_count = (height + kRowsPerBand - 1) / kRowsPerBand;
  oneapi::tbb::parallel_for(0, band_count, [&](int band) {
    Band(depth, options, prepared, filter, connected, is_small ? &edge_slopes : nullptr,
         band * kRowsPerBand, std::min((band + 1) * kRowsPerBand, height))
        .run(take);
  });
}

}  // namespace estimation
