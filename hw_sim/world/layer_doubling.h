// What a half space of skin reflects by direction, all places together, without a photon's noise:
// adding and doubling of layers (Hansen and Travis, Space Science Reviews 16 (1974), section 3),
// with a Fresnel boundary on top. Light that enters and leaves anywhere needs no place, so the
// azimuths come apart.
#pragma once

#include <array>

#include "hw_sim/world/angular_basis.h"

namespace hw_sim {

struct HalfSpaceTotals {
  // [|k|][incidence][exit], at the nodes: what the orders (0, k) of angular_basis.h sum to over the
  // plane.
  std::array<std::array<std::array<double, kAngleNodes>, kAngleNodes>, 3> by_direction{};
  double reflectance = 0;  // R_d: normal incidence, all exits
};

// absorption: sigma_a / sigma_s', at least ScatterTable::kLeastRatio. White_walk.h's index and
// phase function. Within 1e-5 of its limit of fine layers.
HalfSpaceTotals half_space_totals(double absorption);

}  // namespace hw_sim
