// How a Hermitian function of two directions is written as numbers: the reflection of light from
// one direction into another at one spatial frequency along the stripes' axis (x).
//
// A direction is the point (x, y) of the unit disc that it projects to on the surface, outside of
// the medium. Over the disc stand the real Zernike polynomials Z_a up to kOrder, orthonormal for
// the uniform mean. For G(incidence, exit), both directions away from the surface,
//   reciprocity          G(i, o) = conj G(o, i)
//   mirror in y          G does not change if both y change sign
//   mirror in x          G becomes its conjugate if both x change sign
// leave, of all products Z_a(i) Z_b(o), the pairs listed here: real coefficients with
// Z_a(i) Z_b(o) + Z_b(i) Z_a(o), imaginary ones with Z_a(i) Z_b(o) - Z_b(i) Z_a(o).
#pragma once

#include <array>
#include <cstddef>

namespace estimation {

struct DiscPoint {
  double x = 0, y = 0;  // sine of the angle to the normal, times cosine and sine of the azimuth
};

class DirectionPairs {
 public:
  static constexpr int kOrder = 4;
  static constexpr std::size_t kPolynomials = (kOrder + 1) * (kOrder + 2) / 2;
  static constexpr std::size_t kRealPairs = 39, kImaginaryPairs = 27;
  static constexpr std::size_t kPairs = kRealPairs + kImaginaryPairs;

  using Polynomials = std::array<double, kPolynomials>;
  static Polynomials polynomials(DiscPoint point);

  // By what each coefficient is multiplied in G(incidence, exit): the real ones first. Orthonormal
  // for the mean over both discs, so a coefficient is the mean of G's real (or imaginary) part
  // times its basis.
  using Basis = std::array<double, kPairs>;
  static Basis basis(const Polynomials& incidence, const Polynomials& exit);
};

}  // namespace estimation
