#include "estimation/profile/start_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace estimation {
namespace {

constexpr int kSteps = 8;
// Of ln a_1 below its greatest value: weaker harmonics are noise.
constexpr double kGreatestDecline = 12;

struct Coordinates {
  double x = 0, y = 0;
};

struct Slopes {
  Coordinates at, by_logit, by_log;
};

// The coordinates of a shape and their derivatives.
class Forward {
 public:
  Forward(const HarmonicTable& table, IndirectLight indirect, int second, double sharp_ratio)
      : table_(table),
        indirect_(indirect),
        second_(static_cast<std::size_t>(second - 1)),
        sharp_ratio_(sharp_ratio) {}

  Slopes at(ShapePoint point) const {
    const ShapePoint& least = table_.range().least;
    const double row =
        std::round((point.logit_reflectance - least.logit_reflectance) / table_.logit_step());
    const double col =
        std::round((point.log_translucency_px - least.log_translucency_px) / table_.log_step());
    const double dt = point.logit_reflectance - least.logit_reflectance - row * table_.logit_step();
    const double dl =
        point.log_translucency_px - least.log_translucency_px - col * table_.log_step();
    const std::span<const float> node = table_.node(static_cast<int>(row), static_cast<int>(col));
    const auto taylor = [&](std::size_t n) {
      const auto term = [&](std::size_t i) {
        return static_cast<double>(node[i * table_.harmonic_stride() + n]);
      };
      return std::array<double, 3>{
          term(0) + dt * (term(1) + dt * term(3) + dl * term(4)) + dl * (term(2) + dl * term(5)),
          term(1) + 2 * dt * term(3) + dl * term(4), term(2) + 2 * dl * term(5) + dt * term(4)};
    };
    const std::array<double, 3> first = taylor(0);
    const double size = std::max(first[0], 1e-30);
    Slopes slopes{.at = {std::log(size), point.logit_reflectance},
                  .by_logit = {first[1] / size, 1},
                  .by_log = {first[2] / size, 0}};
    if (indirect_ == IndirectLight::kZero) return slopes;
    const std::array<double, 3> other = taylor(second_);
    const double ratio = std::max(other[0] / (size * sharp_ratio_), 1e-12);
    const double decay = std::max(-std::log(ratio), StartGrid::kLeastDecay);
    const auto slope = [&](std::size_t i) {
      const double share = std::abs(other[0]) > 1e-30 ? other[i] / other[0] : 0;
      return -(share - first[i] / size) / decay;
    };
    slopes.at.y = std::log(decay);
    slopes.by_logit.y = slope(1);
    slopes.by_log.y = slope(2);
    return slopes;
  }

 private:
  const HarmonicTable& table_;
  IndirectLight indirect_;
  std::size_t second_;
  double sharp_ratio_;
};

// Newton's method from a shape nearby; stays in the table.
ShapePoint invert(const Forward& forward, const ShapeRange& range, Coordinates target,
                  ShapePoint point) {
  const auto distance = [&](Coordinates at) {
    return std::hypot(at.x - target.x, at.y - target.y);
  };
  Slopes now = forward.at(point);
  for (int step = 0; step < kSteps; ++step) {
    const double x = target.x - now.at.x, y = target.y - now.at.y;
    const double determinant = now.by_logit.x * now.by_log.y - now.by_log.x * now.by_logit.y;
    if (!(std::abs(determinant) > 1e-12)) break;
    const ShapePoint next{
        std::clamp(point.logit_reflectance +
                       std::clamp((x * now.by_log.y - now.by_log.x * y) / determinant, -1.0, 1.0),
                   range.least.logit_reflectance, range.greatest.logit_reflectance),
        std::clamp(
            point.log_translucency_px +
                std::clamp((now.by_logit.x * y - x * now.by_logit.y) / determinant, -1.0, 1.0),
            range.least.log_translucency_px, range.greatest.log_translucency_px)};
    const Slopes there = forward.at(next);
    if (!(distance(there.at) < distance(now.at))) break;
    point = next;
    now = there;
  }
  return point;
}

}  // namespace

StartGrid::StartGrid(const HarmonicTable& table, IndirectLight indirect, int second)
    : logit(kSide * kSide), log(kSide * kSide) {
  const auto sinc = [&](int n) {
    return std::sin(std::numbers::pi * n * table.shape().width_px / table.shape().period_px) / n;
  };
  second = std::min(second, table.harmonic_count());
  sharp_ratio = static_cast<float>(kRatioMargin * sinc(second) / sinc(1));
  const Forward forward(table, indirect, second, static_cast<double>(sharp_ratio));

  // Where the table's shapes lie, seen at as many of them as the grid has points.
  struct Seen {
    ShapePoint shape;
    Coordinates at;
  };
  std::vector<Seen> seen;
  const auto& [least, greatest] = table.range();
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j) {
      const ShapePoint shape{std::lerp(least.logit_reflectance, greatest.logit_reflectance,
                                       static_cast<double>(i) / (kSide - 1)),
                             std::lerp(least.log_translucency_px, greatest.log_translucency_px,
                                       static_cast<double>(j) / (kSide - 1))};
      seen.push_back({shape, forward.at(shape).at});
    }
  Coordinates low{1e30, 1e30}, high{-1e30, -1e30};
  for (const Seen& s : seen) {
    high = {std::max(high.x, s.at.x), std::max(high.y, s.at.y)};
    low = {std::min(low.x, s.at.x), std::min(low.y, s.at.y)};
  }
  low.x = std::max(low.x, high.x - kGreatestDecline);
  const double cell_x = std::max(high.x - low.x, 1e-6) / (kSide - 1);
  const double cell_y = std::max(high.y - low.y, 1e-6) / (kSide - 1);
  first_x = static_cast<float>(low.x);
  first_y = static_cast<float>(low.y);
  per_x = static_cast<float>(1 / cell_x);
  per_y = static_cast<float>(1 / cell_y);

  // The nearest shape seen starts Newton; found by dropping the shapes into the grid's cells and
  // spreading them to empty neighbours.
  std::vector<int> nearest(kSide * kSide, -1);
  const auto index = [](int i, int j) { return static_cast<std::size_t>(i * kSide + j); };
  for (std::size_t s = 0; s < seen.size(); ++s) {
    const int i = static_cast<int>(std::lround((seen[s].at.x - low.x) / cell_x));
    const int j = static_cast<int>(std::lround((seen[s].at.y - low.y) / cell_y));
    if (i >= 0 && i < kSide && j >= 0 && j < kSide) nearest[index(i, j)] = static_cast<int>(s);
  }
  for (bool has_spread = true; has_spread;) {
    has_spread = false;
    const std::vector<int> before = nearest;
    for (int i = 0; i < kSide; ++i)
      for (int j = 0; j < kSide; ++j) {
        if (before[index(i, j)] >= 0) continue;
        for (const auto& [di, dj] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
          const int ni = i + di, nj = j + dj;
          if (ni < 0 || ni >= kSide || nj < 0 || nj >= kSide || before[index(ni, nj)] < 0) continue;
          nearest[index(i, j)] = before[index(ni, nj)];
          has_spread = true;
        }
      }
  }
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j) {
      const int from = std::max(nearest[index(i, j)], 0);
      const ShapePoint shape =
          invert(forward, table.range(), {low.x + i * cell_x, low.y + j * cell_y},
                 seen[static_cast<std::size_t>(from)].shape);
      logit[index(i, j)] = static_cast<float>(shape.logit_reflectance);
      log[index(i, j)] = static_cast<float>(shape.log_translucency_px);
    }
}

}  // namespace estimation
