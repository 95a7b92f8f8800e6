// Cubic splines on uniform nodes 0, 1, 2 ..., twice continuously differentiable, straight beyond
// the last node. Written as sums of B-splines, so that a value costs four multiplications a
// dimension.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

namespace estimation {

enum class SplineStart {
  kEven,    // mirrored at node 0: for functions of the square of a coordinate
  kNatural  // second derivative 0 at node 0
};

// Where a value lies: its first coefficient and the four weights.
struct SplinePlace {
  std::size_t first;
  std::array<double, 4> weight;

  // `place` >= 0 in nodes; `node_count` of the spline.
  SplinePlace(double place, std::size_t node_count);
  double sum(const double* coefficients) const {
    const double* c = coefficients + first;
    return weight[0] * c[0] + weight[1] * c[1] + weight[2] * c[2] + weight[3] * c[3];
  }
};

// The coefficients of the spline through these values, node_count + 2 of them.
std::vector<double> spline_coefficients(std::span<const double> values, SplineStart start);

inline SplinePlace::SplinePlace(double place, std::size_t node_count) {
  const auto last = static_cast<double>(node_count - 2);
  const double cell = std::floor(std::min(place, last));
  first = static_cast<std::size_t>(cell);
  const double t = place - cell;
  if (t > 1) {
    // The tangent at the last node, where the spline's second derivative is 0.
    const double beyond = 0.5 * (t - 1);
    weight = {0, 1.0 / 6 - beyond, 4.0 / 6, 1.0 / 6 + beyond};
    return;
  }
  const double u = 1 - t;
  weight = {u * u * u / 6, (4 - 3 * t * t * (1 + u)) / 6, (4 - 3 * u * u * (1 + t)) / 6,
            t * t * t / 6};
}

}  // namespace estimation
