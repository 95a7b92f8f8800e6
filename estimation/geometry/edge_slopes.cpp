#include "estimation/geometry/edge_slopes.h"

#include <algorithm>
#include <array>
#include <span>

namespace estimation {
namespace {

constexpr int kReach = 3;  // points looked at on either side

// f'(0) from f at first_offset, first_offset + 1, ..., exact for polynomials of its order.
struct Stencil {
  int first_offset = 0, order = 0;
  std::array<double, 5> weights{};
};
constexpr std::array<Stencil, 11> kStencils{{
    {-2, 4, {1.0 / 12, -8.0 / 12, 0, 8.0 / 12, -1.0 / 12}},
    {-2, 3, {1.0 / 6, -1, 0.5, 1.0 / 3, 0}},
    {-1, 3, {-1.0 / 3, -0.5, 1, -1.0 / 6, 0}},
    {-3, 3, {-1.0 / 3, 1.5, -3, 11.0 / 6, 0}},
    {0, 3, {-11.0 / 6, 3, -1.5, 1.0 / 3, 0}},
    {-1, 2, {-0.5, 0, 0.5, 0, 0}},
    {-2, 2, {0.5, -2, 1.5, 0, 0}},
    {0, 2, {-1.5, 2, -0.5, 0, 0}},
    {-1, 1, {-1, 1, 0, 0, 0}},
    {0, 1, {-1, 1, 0, 0, 0}},
    {0, 0, {0, 0, 0, 0, 0}},
}};

int last_offset(const Stencil& stencil) {
  int last = stencil.first_offset;
  for (std::size_t i = 0; i < stencil.weights.size(); ++i)
    if (stencil.weights[i] != 0) last = stencil.first_offset + static_cast<int>(i);
  return last;
}

}  // namespace

EdgeSlopes::Slope EdgeSlopes::along(int row, int col, int down, int right, Slope window) const {
  const ImageView<const float> inverse = neighbours_.depth.inverse_depth_per_mm;
  const auto linked_steps = [&](int sign) {
    int steps = 0;
    for (; steps < kReach; ++steps) {
      const int r = row + sign * steps * down, c = col + sign * steps * right;
      const int next_r = r + sign * down, next_c = c + sign * right;
      if (next_r < 0 || next_c < 0 || next_r >= inverse.height_px || next_c >= inverse.width_px ||
          !neighbours_.are_linked(r, c, next_r, next_c, 1))
        break;
    }
    return steps;
  };
  const int back = linked_steps(-1), ahead = linked_steps(1);
  const double here = double{inverse.at(row, col)};
  const double noise = here * double{neighbours_.depth.relative_sd.at(row, col)};
  std::array<Slope, kStencils.size()> found;
  std::array<int, kStencils.size()> order{};
  std::size_t count = 0;
  for (const Stencil& stencil : kStencils) {
    if (-stencil.first_offset > back || last_offset(stencil) > ahead || stencil.order == 0)
      continue;
    Slope& slope = found[count];
    double squares = 0;
    for (std::size_t i = 0; i < stencil.weights.size(); ++i) {
      const double weight = stencil.weights[i];
      if (weight == 0) continue;
      const int step = stencil.first_offset + static_cast<int>(i);
      slope.value += weight * (double{inverse.at(row + step * down, col + step * right)} - here);
      squares += weight * weight;
    }
    slope.noise = noise * std::sqrt(squares);
    order[count++] = stencil.order;
  }
  if (count == 0) return window;
  // What the next order changes is how far off a slope is; the last one's is below that, and not
  // known better. A window's is a plane's.
  const int highest = order[0];
  const auto beyond_noise = [&](const Slope& slope) {
    const double off = slope.value - found[0].value;
    return std::sqrt(
        std::max(off * off - slope.noise * slope.noise - found[0].noise * found[0].noise, 0.0));
  };
  for (std::size_t i = 0; i < count; ++i)
    found[i].bias = order[i] < highest ? beyond_noise(found[i]) : 0;
  if (highest == 1) {
    found[0].bias = std::abs(found[0].value - window.value);
  } else if (highest < 4) {
    const auto below = static_cast<std::size_t>(
        std::find_if(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count),
                     [&](int o) { return o < highest; }) -
        order.begin());
    if (below < count) {
      const double left = 0.5 * beyond_noise(found[below]);
      for (std::size_t i = 0; i < count; ++i) found[i].bias = std::max(found[i].bias, left);
    }
  }
  window.bias = std::max(beyond_noise(window), found[0].bias);
  Slope best = window;
  for (std::size_t i = 0; i < count; ++i)
    if (found[i].error() < best.error()) best = found[i];
  return best;
}

PointFit EdgeSlopes::at(int row, int col, const PointFit& window) const {
  if (!window.is_valid) return window;
  const DepthMap& depth = neighbours_.depth;
  const double noise =
      double{depth.inverse_depth_per_mm.at(row, col)} * double{depth.relative_sd.at(row, col)};
  const double window_noise = window.slope_gain * noise;
  const Slope by_x = along(row, col, 0, 1, {window.by_x, window_noise, 0});
  const Slope by_y = along(row, col, 1, 0, {window.by_y, window_noise, 0});
  PointFit fit = window;
  fit.by_x = by_x.value;
  fit.by_y = by_y.value;
  if (noise > 0) fit.slope_gain = std::hypot(by_x.error(), by_y.error()) / std::sqrt(2.0) / noise;
  return fit;
}

}  // namespace estimation
