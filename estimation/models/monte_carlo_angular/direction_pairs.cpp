#include "estimation/models/monte_carlo_angular/direction_pairs.h"

#include <cmath>
#include <cstdlib>
#include <numbers>
#include <vector>

#include "estimation/base/check.h"

namespace estimation {
namespace {

struct Pair {
  std::size_t first, second;
  double scale;
};

struct Term {
  double factor;
  int x_power, y_power;
};
using Polynomial = std::vector<Term>;

double binomial(int n, int k) {
  double value = 1;
  for (int i = 1; i <= k; ++i) value = value * (n - k + i) / i;
  return value;
}

// r^(2 j) r^|m| cos or sin(|m| phi) as powers of x and y.
void add_turning(Polynomial& to, double factor, int j, int m) {
  const int order = std::abs(m);
  for (int q = m >= 0 ? 0 : 1; q <= order; q += 2) {
    // Re or Im of (x + i y)^order: (-1)^(q/2) binomial(order, q) x^(order - q) y^q.
    const double turning = factor * binomial(order, q) * ((q / 2) % 2 == 0 ? 1 : -1);
    for (int p = 0; p <= j; ++p)
      to.push_back({turning * binomial(j, p), order - q + 2 * (j - p), q + 2 * p});
  }
}

// Z_n^m, orthonormal for the mean over the disc.
Polynomial zernike(int n, int m) {
  const int order = std::abs(m);
  const double norm = std::sqrt((m == 0 ? 1.0 : 2.0) * (n + 1));
  Polynomial polynomial;
  for (int s = 0; s <= (n - order) / 2; ++s) {
    const double factor =
        (s % 2 == 0 ? 1 : -1) * binomial(n - s, s) * binomial(n - 2 * s, (n - order) / 2 - s);
    add_turning(polynomial, norm * factor, (n - order) / 2 - s, m);
  }
  return polynomial;
}

struct Tables {
  // [polynomial][power of x][power of y], dense up to the order.
  static constexpr std::size_t kPowers = DirectionPairs::kOrder + 1;
  std::array<std::array<std::array<double, kPowers>, kPowers>, DirectionPairs::kPolynomials>
      factor{};
  std::vector<Pair> real, imaginary;

  Tables() {
    std::size_t count = 0;
    std::array<bool, DirectionPairs::kPolynomials> is_odd_in_x{}, is_odd_in_y{};
    for (int n = 0; n <= DirectionPairs::kOrder; ++n)
      for (int m = -n; m <= n; m += 2) {
        const Polynomial polynomial = zernike(n, m);
        for (const Term& term : polynomial)
          factor[count][static_cast<std::size_t>(term.x_power)]
                [static_cast<std::size_t>(term.y_power)] += term.factor;
        is_odd_in_x[count] = polynomial.front().x_power % 2 != 0;
        is_odd_in_y[count] = polynomial.front().y_power % 2 != 0;
        ++count;
      }
    for (std::size_t a = 0; a < count; ++a)
      for (std::size_t b = a; b < count; ++b) {
        if (is_odd_in_y[a] != is_odd_in_y[b]) continue;
        if (is_odd_in_x[a] == is_odd_in_x[b])
          real.push_back({a, b, a == b ? 0.5 : std::numbers::sqrt2 / 2});
        else
          imaginary.push_back({a, b, std::numbers::sqrt2 / 2});
      }
    check(real.size() == DirectionPairs::kRealPairs &&
              imaginary.size() == DirectionPairs::kImaginaryPairs,
          "as many pairs as the symmetries leave");
  }
};

const Tables& tables() {
  static const Tables kTables;
  return kTables;
}

}  // namespace

DirectionPairs::Polynomials DirectionPairs::polynomials(DiscPoint point) {
  constexpr std::size_t kPowers = Tables::kPowers;
  Polynomials values;
  const auto& factor = tables().factor;
  for (std::size_t a = 0; a < kPolynomials; ++a) {
    double sum = 0;
    for (std::size_t p = kPowers; p-- > 0;) {
      double along_y = 0;
      for (std::size_t q = kPowers - p; q-- > 0;) along_y = along_y * point.y + factor[a][p][q];
      sum = sum * point.x + along_y;
    }
    values[a] = sum;
  }
  return values;
}

DirectionPairs::Basis DirectionPairs::basis(const Polynomials& incidence, const Polynomials& exit) {
  Basis basis;
  std::size_t next = 0;
  for (const Pair& pair : tables().real)
    basis[next++] = pair.scale * (incidence[pair.first] * exit[pair.second] +
                                  incidence[pair.second] * exit[pair.first]);
  for (const Pair& pair : tables().imaginary)
    basis[next++] = pair.scale * (incidence[pair.first] * exit[pair.second] -
                                  incidence[pair.second] * exit[pair.first]);
  return basis;
}

}  // namespace estimation
