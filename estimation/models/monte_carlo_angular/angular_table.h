// The reflection of a half space between all directions as numbers, as a file holds it; made by
// angular_score.h, used by models/monte_carlo_angular.h.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/models/monte_carlo/scattering_table.h"
#include "estimation/models/monte_carlo_angular/direction_pairs.h"

namespace estimation {

// Of the table's nodes, in units of sigma_s': s as in TableGrid, and k.
inline constexpr TableGrid kAngularGridS{0.1, 0.4, 14};   // to 9.1: sigma_a up to 4.8 sigma_s'
inline constexpr TableGrid kAngularGridK{0.2, 0.35, 15};  // to 13

// G(i, o; s, k): the light of a pattern exp(i k x) that a surface element reflects from direction i
// into o, as radiance times pi over the flux that enters the medium, but for the exit's Fresnel
// transmission T(o) (see DirectionPairs for how it depends on i and o).
struct AngularTable {
  double eta = 1.4, anisotropy = 0.8;
  std::string program;  // that made it, with its version
  std::int64_t photon_count = 0;
  std::uint64_t seed = 0;
  // [s][k] over the nodes of the grids: coefficients of G.
  std::vector<std::array<float, DirectionPairs::kPairs>> coefficients;
  // [s][k] standard error of one coefficient, root mean square over all.
  std::vector<float> coefficient_se;

  static std::size_t at(int s_index, int k_index) {
    return static_cast<std::size_t>(s_index) * static_cast<std::size_t>(kAngularGridK.node_count) +
           static_cast<std::size_t>(k_index);
  }
  static std::size_t node_count() { return at(kAngularGridS.node_count, 0); }
};

// Coefficients are rounded to 1e-5 of a node's first, which is the mean over both hemispheres.
std::string to_text(const AngularTable& table);

// Errors: kInvalid, naming `name` and the line, for a text that to_text would not write.
Result<AngularTable> angular_table_from_text(std::string_view text, const std::string& name);

}  // namespace estimation
