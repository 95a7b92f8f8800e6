// Least squares over the neighbours that belong to a pixel's own surface: for windows that a border
// or a jump cuts, where a fixed filter will not do.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/smoothing.h"

namespace estimation {

// Whether two points lie on one surface.
struct Neighbours {
  const DepthMap& depth;
  float max_relative_step = 0;

  // False if one of them is missing.
  bool are_linked(int row, int col, int other_row, int other_col, int distance_px) const {
    const float a = depth.inverse_depth_per_mm.at(row, col);
    const float b = depth.inverse_depth_per_mm.at(other_row, other_col);
    const float a_sd = depth.relative_sd.at(row, col);
    const float b_sd = depth.relative_sd.at(other_row, other_col);
    // Depths of neighbours differ by noise of this many standard deviations before it is a jump.
    constexpr float kJumpSd = 5;
    const float limit = max_relative_step * static_cast<float>(distance_px) +
                        kJumpSd * std::sqrt(a_sd * a_sd + b_sd * b_sd);
    return std::abs(a - b) <= limit * std::min(a, b);
  }
};

struct PointFit {
  double value = 0, by_x = 0, by_y = 0;
  double noise_gain = 0, slope_gain = 0;  // as in FitRow
  bool is_valid = false;
};

// Immutable, so thread-safe; borrows the depth.
class ConnectedFit {
 public:
  // Looks at every pixel once, in the caller's oneTBB arena.
  ConnectedFit(const Neighbours& neighbours, int radius_px);

  PointFit at(int row, int col) const;

 private:
  // The window is sampled this many times on either side.
  static constexpr int kMostSamples = 4;
  static constexpr std::size_t kMostSize = 2 * kMostSamples + 1;
  static constexpr std::size_t kMoments = 15;  // x^i y^j, i + j <= 4
  using Moments = std::array<double, kMoments>;

  std::array<unsigned, kMostSize> reachable(int row, int col) const;

  const DepthMap& depth_;
  int radius_px_, stride_px_, samples_;
  Image<unsigned char> links_;  // bit 0: to the point stride_px_ to the right, bit 1: below
  // Of each sample of the window: weight and its square times x^i y^j, in units of the radius.
  std::vector<Moments> moments_, square_moments_;
};

}  // namespace estimation
