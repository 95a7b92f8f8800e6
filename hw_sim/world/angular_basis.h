// How light that comes out of skin depends on where it came from and where it goes: the few numbers
// that ScatterTable holds for each place. With a the azimuth of the place and b that of the exit,
// both from the way in,
//
//   radiance = y(exit) sum over orders (m, k) of cos(m a + k b) g_mk(in, exit),
//
// where y is what the boundary lets through and g_mk goes as sin^|m+k| of the incidence and sin^|k|
// of the exit, times what is smooth in the squares of these sines: light inside travels within 46
// degrees of the normal whatever its direction outside. Polynomials in sin^2 through four nodes.
#pragma once

#include <array>
#include <cstddef>

namespace hw_sim {

inline constexpr std::size_t kAngularOrders = 13, kAngularStride = 16;  // padded for vectors

struct AngularOrder {
  int m = 0, k = 0;
};
inline constexpr std::array<AngularOrder, kAngularOrders> kOrders = {{{0, 0},
                                                                      {0, 1},
                                                                      {0, 2},
                                                                      {1, -2},
                                                                      {1, -1},
                                                                      {1, 0},
                                                                      {1, 1},
                                                                      {1, 2},
                                                                      {2, -2},
                                                                      {2, -1},
                                                                      {2, 0},
                                                                      {2, 1},
                                                                      {2, 2}}};
constexpr int power_of(int order) { return order < 0 ? -order : order; }

// Where incidence and exit are tabulated, as sin^2: Lobatto's points, whose ends are the normal and
// the horizon.
inline constexpr std::size_t kAngleNodes = 4;
inline constexpr std::array<double, kAngleNodes> kNodeSines2 = {0, 0.27639320225002103,
                                                                0.72360679774997897, 1};

// The share of the radiance inside that the boundary lets out.
double typical_radiance(double exit_rad);

// By node and order: what the node's value counts at an angle.
using NodeWeights = std::array<std::array<float, kAngularStride>, kAngleNodes>;
NodeWeights incidence_weights(double incidence_rad);
NodeWeights exit_weights(double exit_rad);

// Exits of photons come at any angle: polynomials of second degree in sin^2, orthonormal where
// photons leave. A projection has no bias where the light is such a polynomial, and the photons
// between two nodes count for both.
class ExitProjection {
 public:
  static constexpr std::size_t kTerms = 3;
  ExitProjection();

  // [term][|k|]: what a photon that leaves with sin^2 = `sine2` adds to each term.
  using Terms = std::array<std::array<double, 3>, kTerms>;
  Terms terms(double sine2) const;
  // The value of g_mk at a node from the sums of its terms; power = |k|.
  double at_node(std::size_t node, std::size_t power, const std::array<double, kTerms>& sums) const;
  // How much the photons' noise counts there, relative.
  double variance_at_node(std::size_t node, std::size_t power) const;

 private:
  std::array<double, 3> polynomials(double sine2, std::size_t power) const;
  // [power][term][coefficient of sin^(2 i)]
  std::array<std::array<std::array<double, kTerms>, kTerms>, 3> coefficients_{};
};

}  // namespace hw_sim
