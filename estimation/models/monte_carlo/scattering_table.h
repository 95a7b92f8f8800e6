// The scattering of one medium as numbers, as a file holds it: R~(k) of a half space at normal
// incidence, per flux transmitted into it, all exit directions together, and how its exit radiance
// depends on direction. Made by white_table.h, used by models/monte_carlo.h.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/session/error.h"

namespace estimation {

// Both axes have the same nodes, uniform in asinh: s and k in units of sigma_s', with
// s = 1 / (l_d sigma_s') = sqrt(3 x (1 + x)) for the absorption x = sigma_a / sigma_s'.
struct TableGrid {
  double scale = 0.01, step = 0.2;
  int node_count = 0;

  double node(int index) const { return scale * std::sinh(step * index); }
  // In nodes, of a value >= 0. Not std::asinh, which costs twice as much: the digits this one loses
  // far below the first node do not matter to a function that is even there.
  double place(double value) const {
    const double z = std::fmin(value / scale, 1e150);
    return std::log(z + std::sqrt(1 + z * z)) / step;
  }
};

// x = sigma_a/sigma_s' at s, exact at both ends.
inline double absorption_at(double s) {
  const double root = s / std::sqrt(3.0);
  return root * (2 * root / (1 + std::hypot(1.0, 2 * root)));
}

// h(c) = (1 - F(c)) (b_0 + b_1 v + b_2 v^2 + b_3 v^3), v = 1 - c^2, c the exit cosine: the exit
// radiance over that of a Lambertian surface of the same exitance.
using ExitRadiance = std::array<double, 4>;

struct ScatteringTable {
  double eta = 1.4, anisotropy = 0.8;
  std::string program;  // that made it, with its version
  std::int64_t photon_count = 0;
  std::uint64_t seed = 0;
  // Weight out plus weight left, less 1: roulette's noise, and its standard error.
  double energy_residual = 0, energy_residual_se = 0;
  double slope = 0;  // 1 - R~ -> slope * sqrt(s^2 + k^2) at the origin
  TableGrid grid;
  std::vector<double> log_transform;        // ln R~, [s][k]
  std::vector<double> log_transform_se;     // its standard error, [s][k]
  std::vector<ExitRadiance> exit_radiance;  // [s]
  std::vector<double> exit_radiance_se;     // of h at normal exit, [s]

  std::size_t at(int s_index, int k_index) const {
    return static_cast<std::size_t>(s_index) * static_cast<std::size_t>(grid.node_count) +
           static_cast<std::size_t>(k_index);
  }
};

// ln R~ is rounded to 1e-6 and its standard error up to 1e-5.
std::string to_text(const ScatteringTable& table);

// Errors: kInvalid, naming `name` and the line, for a text that to_text would not write.
Result<ScatteringTable> scattering_table_from_text(std::string_view text, const std::string& name);

// The same without the numbers: which medium, how many photons.
Result<ScatteringTable> scattering_table_head(std::string_view text, const std::string& name);

}  // namespace estimation
