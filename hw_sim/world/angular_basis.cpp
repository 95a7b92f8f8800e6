#include "hw_sim/world/angular_basis.h"

#include <cmath>
#include <numbers>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

namespace {

// Lagrange's weights of the nodes from `first` on.
std::array<double, kAngleNodes> lagrange(std::size_t first, double sine2) {
  std::array<double, kAngleNodes> weights{};
  for (std::size_t i = first; i < kAngleNodes; ++i) {
    weights[i] = 1;
    for (std::size_t j = first; j < kAngleNodes; ++j)
      if (j != i) weights[i] *= (sine2 - kNodeSines2[j]) / (kNodeSines2[i] - kNodeSines2[j]);
  }
  return weights;
}

template <typename PowerOf>
NodeWeights weights_at(double angle_rad, const PowerOf& power) {
  const double sine = std::sin(angle_rad), sine2 = sine * sine;
  const auto even = lagrange(0, sine2);
  // What vanishes at the normal says nothing there.
  const auto others = lagrange(1, sine2);
  NodeWeights weights{};
  for (std::size_t i = 0; i < kAngularOrders; ++i) {
    const int s = power(kOrders[i]);
    for (std::size_t node = s == 0 ? 0 : 1; node < kAngleNodes; ++node)
      weights[node][i] = static_cast<float>(
          s == 0 ? even[node] : others[node] * std::pow(sine / std::sqrt(kNodeSines2[node]), s));
  }
  return weights;
}

// The integral over the exits by Lambert's law, which is even in sin^2, of y sin^(2 power) use().
template <typename Use>
double over_exits(std::size_t power, const Use& use) {
  constexpr int kSteps = 2000;
  double sum = 0;
  for (int i = 0; i < kSteps; ++i) {
    const double angle_rad = (i + 0.5) / kSteps * std::numbers::pi / 2;
    const double sine2 = std::pow(std::sin(angle_rad), 2);
    sum += std::sin(2 * angle_rad) * typical_radiance(angle_rad) *
           std::pow(sine2, static_cast<double>(power)) * use(sine2);
  }
  return sum * std::numbers::pi / 2 / kSteps;
}

}  // namespace

double typical_radiance(double exit_rad) {
  return 1 - fresnel_reflectance(std::cos(exit_rad), 1, kSkinIndex);
}

NodeWeights incidence_weights(double incidence_rad) {
  return weights_at(incidence_rad,
                    [](const AngularOrder& order) { return power_of(order.m + order.k); });
}

NodeWeights exit_weights(double exit_rad) {
  return weights_at(exit_rad, [](const AngularOrder& order) { return power_of(order.k); });
}

// Gram and Schmidt.
ExitProjection::ExitProjection() {
  for (std::size_t power = 0; power < coefficients_.size(); ++power)
    for (std::size_t term = 0; term < kTerms; ++term) {
      std::array<double, kTerms> own{};
      own[term] = 1;
      const auto value = [&](const std::array<double, kTerms>& c, double t) {
        return c[0] + t * (c[1] + t * c[2]);
      };
      for (std::size_t before = 0; before < term; ++before) {
        const auto& other = coefficients_[power][before];
        const double shared =
            over_exits(power, [&](double t) { return value(own, t) * value(other, t); });
        for (std::size_t i = 0; i < kTerms; ++i) own[i] -= shared * other[i];
      }
      const double norm =
          std::sqrt(over_exits(power, [&](double t) { return value(own, t) * value(own, t); }));
      for (double& c : own) c /= norm;
      coefficients_[power][term] = own;
    }
}

std::array<double, 3> ExitProjection::polynomials(double sine2, std::size_t power) const {
  std::array<double, 3> values{};
  for (std::size_t term = 0; term < kTerms; ++term) {
    const auto& c = coefficients_[power][term];
    values[term] = c[0] + sine2 * (c[1] + sine2 * c[2]);
  }
  return values;
}

ExitProjection::Terms ExitProjection::terms(double sine2) const {
  const double sine = std::sqrt(sine2);
  Terms terms{};
  for (std::size_t power = 0; power < 3; ++power) {
    const double scale = power == 0 ? 1 : power == 1 ? sine : sine2;
    const auto values = polynomials(sine2, power);
    for (std::size_t term = 0; term < kTerms; ++term) terms[term][power] = scale * values[term];
  }
  return terms;
}

double ExitProjection::at_node(std::size_t node, std::size_t power,
                               const std::array<double, kTerms>& sums) const {
  const auto values = terms(kNodeSines2[node]);
  double value = 0;
  for (std::size_t term = 0; term < kTerms; ++term) value += values[term][power] * sums[term];
  return value;
}

double ExitProjection::variance_at_node(std::size_t node, std::size_t power) const {
  const auto values = terms(kNodeSines2[node]);
  double variance = 0;
  for (std::size_t term = 0; term < kTerms; ++term)
    variance += values[term][power] * values[term][power];
  return variance;
}

}  // namespace hw_sim
