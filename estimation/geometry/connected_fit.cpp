#include "estimation/geometry/connected_fit.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <opencv2/core.hpp>

namespace estimation {
namespace {

constexpr int kMinQuadricPoints = 15;
constexpr int kMinPlanePoints = 4;
constexpr unsigned char kLinkedRight = 1, kLinkedDown = 2;

// Of x^i y^j among the moments, by rising degree: 1, x, y, x^2, xy, y^2, x^3, ...
constexpr std::size_t moment_index(std::size_t i, std::size_t j) {
  return (i + j) * (i + j + 1) / 2 + j;
}

// The terms of a quadric, in the same order.
constexpr std::array<std::array<std::size_t, 2>, 6> kTerms{
    {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}}};

template <int kCount, typename Moments>
cv::Matx<double, kCount, kCount> matrix_of(const Moments& moments) {
  cv::Matx<double, kCount, kCount> matrix;
  for (int a = 0; a < kCount; ++a)
    for (int b = 0; b < kCount; ++b) {
      const auto& p = kTerms[static_cast<std::size_t>(a)];
      const auto& q = kTerms[static_cast<std::size_t>(b)];
      matrix(a, b) = moments[moment_index(p[0] + q[0], p[1] + q[1])];
    }
  return matrix;
}

// Weighted least squares over 1, x, y (and x^2, xy, y^2), coordinates in units of `scale`.
template <int kCount, typename Moments>
PointFit fit_polynomial(const Moments& moments, const Moments& square_moments,
                        const std::array<double, 6>& right, double scale) {
  bool is_regular = false;
  const auto inverse = matrix_of<kCount>(moments).inv(cv::DECOMP_CHOLESKY, &is_regular);
  PointFit fit;
  if (!is_regular) return fit;
  const auto squares = matrix_of<kCount>(square_moments);
  cv::Vec<double, kCount> terms;
  for (int i = 0; i < kCount; ++i) terms[i] = right[static_cast<std::size_t>(i)];
  const cv::Vec<double, kCount> solution = inverse * terms;
  // What noise does to a coefficient: the squares of what each point does to it, summed.
  const auto gain2 = [&](int coefficient) {
    const cv::Matx<double, 1, kCount> influence = inverse.row(coefficient);
    return (influence * squares * influence.t())(0);
  };
  fit = {solution[0],
         solution[1] / scale,
         solution[2] / scale,
         std::sqrt(gain2(0)),
         std::sqrt((gain2(1) + gain2(2)) / 2) / scale,
         false};
  // A centre that extrapolates more than it averages is no fit.
  fit.is_valid = fit.noise_gain <= 1 && std::isfinite(fit.value);
  return fit;
}

}  // namespace

ConnectedFit::ConnectedFit(const Neighbours& neighbours, int radius_px)
    : depth_(neighbours.depth),
      radius_px_(radius_px),
      stride_px_((radius_px + kMostSamples - 1) / kMostSamples),
      samples_(radius_px / stride_px_),
      links_(depth_.inverse_depth_per_mm.height_px, depth_.inverse_depth_per_mm.width_px) {
  for (int gy = -samples_; gy <= samples_; ++gy)
    for (int gx = -samples_; gx <= samples_; ++gx) {
      const double x = double(gx) * stride_px_ / radius_px, y = double(gy) * stride_px_ / radius_px;
      const double weight = std::exp(-2 * (x * x + y * y));
      Moments moments{}, square_moments{};
      for (std::size_t i = 0; i <= 4; ++i)
        for (std::size_t j = 0; i + j <= 4; ++j) {
          const double power = std::pow(x, i) * std::pow(y, j);
          moments[moment_index(i, j)] = weight * power;
          square_moments[moment_index(i, j)] = weight * weight * power;
        }
      moments_.push_back(moments);
      square_moments_.push_back(square_moments);
    }
  const int height = links_.height_px(), width = links_.width_px();
  const auto rows = oneapi::tbb::blocked_range<int>(0, height, 16);
  oneapi::tbb::parallel_for(rows, [&](const oneapi::tbb::blocked_range<int>& range) {
    for (int row = range.begin(); row < range.end(); ++row)
      for (int col = 0; col < width; ++col) {
        if (std::isnan(depth_.inverse_depth_per_mm.at(row, col))) continue;
        const auto is_linked = [&](int r, int c) {
          return r < height && c < width && neighbours.are_linked(row, col, r, c, stride_px_);
        };
        unsigned char links = is_linked(row, col + stride_px_) ? kLinkedRight : 0;
        if (is_linked(row + stride_px_, col)) links |= kLinkedDown;
        links_.at(row, col) = links;
      }
  });
}

// Where links lead to from the centre of the window: bits by rows of its samples.
std::array<unsigned, ConnectedFit::kMostSize> ConnectedFit::reachable(int row, int col) const {
  const int size = 2 * samples_ + 1;
  std::array<unsigned, kMostSize> right{}, down{}, reached{};
  for (int gy = 0; gy < size; ++gy) {
    const int y = row + (gy - samples_) * stride_px_;
    if (y < 0 || y >= links_.height_px()) continue;
    for (int gx = 0; gx < size; ++gx) {
      const int x = col + (gx - samples_) * stride_px_;
      if (x < 0 || x >= links_.width_px()) continue;
      const unsigned char links = links_.at(y, x);
      const auto r = static_cast<std::size_t>(gy);
      if (gx + 1 < size && (links & kLinkedRight) != 0) right[r] |= 1U << gx;
      if (gy + 1 < size && (links & kLinkedDown) != 0) down[r] |= 1U << gx;
    }
  }
  const auto rows = static_cast<std::size_t>(size);
  reached[static_cast<std::size_t>(samples_)] = 1U << samples_;
  for (bool is_growing = true; is_growing;) {
    is_growing = false;
    for (std::size_t r = 0; r < rows; ++r) {
      unsigned more = reached[r];
      if (r > 0) more |= reached[r - 1] & down[r - 1];
      if (r + 1 < rows) more |= reached[r + 1] & down[r];
      more |= (more & right[r]) << 1;
      more |= (more >> 1) & right[r];
      is_growing = is_growing || more != reached[r];
      reached[r] = more;
    }
  }
  return reached;
}

PointFit ConnectedFit::at(int row, int col) const {
  const auto reached = reachable(row, col);
  const int size = 2 * samples_ + 1;
  const double here = double{depth_.inverse_depth_per_mm.at(row, col)};
  Moments moments{}, square_moments{};
  std::array<double, 6> right{};
  int count = 0;
  for (int gy = 0; gy < size; ++gy)
    for (unsigned bits = reached[static_cast<std::size_t>(gy)]; bits != 0; bits &= bits - 1) {
      const int gx = std::countr_zero(bits);
      const auto cell = static_cast<std::size_t>(gy * size + gx);
      const double off =
          double{depth_.inverse_depth_per_mm.at(row + (gy - samples_) * stride_px_,
                                                col + (gx - samples_) * stride_px_)} -
          here;
      for (std::size_t i = 0; i < kMoments; ++i) {
        moments[i] += moments_[cell][i];
        square_moments[i] += square_moments_[cell][i];
      }
      for (std::size_t i = 0; i < right.size(); ++i) right[i] += off * moments_[cell][i];
      ++count;
    }
  PointFit fit;
  if (count >= kMinQuadricPoints)
    fit = fit_polynomial<6>(moments, square_moments, right, radius_px_);
  if (!fit.is_valid && count >= kMinPlanePoints) {
    fit = fit_polynomial<3>(moments, square_moments, right, radius_px_);
    // A plane on one side of the centre is off by the surface's curvature, 0.4 mm at the rim of a
    // sphere of 100 mm at 4.7 mm a pixel: its slopes are taken, the point stays where it was seen.
    fit.value = 0;
    fit.noise_gain = 1;
  }
  fit.value += here;
  return fit;
}

}  // namespace estimation
