// Scenes with a border or a crease, their truth, and what a fit makes of them.
#pragma once

#include <algorithm>
#include <cmath>

#include "estimation/models/dipole.h"
#include "tests/estimation/refine/line_scene.h"

namespace estimation {

// Tariq et al. 2006, Table 2: female cheek and lips, red.
inline const Coefficients kCheekRed{.sigma_a_per_mm = 0.0525, .sigma_s_prime_per_mm = 1.2814};
inline const Coefficients kLipsRed{.sigma_a_per_mm = 0.0657, .sigma_s_prime_per_mm = 1.102};

struct RelativeError {
  double reflectance, translucency, sigma_a, sigma_s_prime;
  double worst() const { return std::max({reflectance, translucency, sigma_a, sigma_s_prime}); }
};

inline RelativeError error_at(const FittedMaps& maps, int col, const Dipole& model,
                              const Coefficients& truth) {
  const int row = maps.translucency_mm.height_px() / 2;
  const double reflectance = static_cast<double>(maps.diffuse_reflectance.at(row, col));
  const double translucency = static_cast<double>(maps.translucency_mm.at(row, col));
  const Coefficients found = model.coefficients(reflectance, translucency);
  return {std::abs(reflectance / dipole_reflectance(truth, 1.4) - 1),
          std::abs(translucency / diffuse_mean_free_path_mm(truth) - 1),
          std::abs(found.sigma_a_per_mm / truth.sigma_a_per_mm - 1),
          std::abs(found.sigma_s_prime_per_mm / truth.sigma_s_prime_per_mm - 1)};
}

inline LineScene::Strip flat_strip(const truth::DipoleLineSpread& spread) {
  return [&spread](double x, double start, double end) {
    return spread.beyond(x - end) - spread.beyond(x - start);
  };
}

inline LineScene half_plane_of_light(const truth::DipoleLineSpread& spread) {
  LineScene scene;
  scene.edge_mm = 0.25;  // between two pixels
  scene.place([](double) { return LineScene::Point{}; });
  scene.light(flat_strip(spread));
  return scene;
}

// A concave crease of 120 degrees: the right side rises towards the camera.
inline constexpr double kTiltRad = 1.0471975511965976;

inline LineScene crease(const truth::DipoleLineSpread& spread) {
  LineScene scene;
  scene.width_px = 161;
  scene.height_px = 81;
  scene.pixel_mm = 0.25;
  const auto height_mm = [](double x) { return x > 0 ? x * std::tan(kTiltRad) : 0.0; };
  scene.place([&](double x) { return LineScene::Point{height_mm(x), x > 0 ? kTiltRad : 0}; });
  // Between points of the surface the light goes straight.
  constexpr double kStepMm = 0.005;
  std::vector<double> table;
  for (double r = 0; r < spread.reach_mm() + kStepMm; r += kStepMm)
    table.push_back(spread.line_spread_per_mm(r));
  const auto line_spread = [&](double r) {
    const auto i = static_cast<std::size_t>(r / kStepMm);
    if (i + 1 >= table.size()) return 0.0;
    return std::lerp(table[i], table[i + 1], r / kStepMm - static_cast<double>(i));
  };
  scene.light([&](double x, double start, double end) {
    constexpr int kPieces = 60;  // of a stripe of 2.4 mm; midpoint rule
    double sum = 0;
    for (int k = 0; k < kPieces; ++k) {
      const double from = start + (end - start) * (k + 0.5) / kPieces;
      sum += line_spread(std::hypot(x - from, height_mm(x) - height_mm(from)));
    }
    return sum * (end - start) / kPieces;
  });
  return scene;
}

}  // namespace estimation
