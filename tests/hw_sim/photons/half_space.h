// Flat phantoms for the volume's photons: half spaces whose reflectance other codes and laws of
// nature know. Used by the tests with few photons and by tests/bench with many.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "hw_sim/photons/adjoint_walk.h"
#include "hw_sim/photons/pixel_response.h"

namespace hw_sim {

// Everything with z > 0; the light comes from z < 0.
class HalfSpace final : public Shape {
 public:
  double distance_mm(const estimation::Vec3& point_mm) const override { return -point_mm[2]; }
  Box bounds() const override { return {{-1, -1, -1}, {1, 1, 1}}; }
};

const ShapeGrid& half_space();

// A unit vector away from the surface, `angle_rad` from its normal.
estimation::Vec3 outward(double angle_rad, double azimuth_rad = 0);

// Parallel light of irradiance 1 across its way.
Lamp sunlight(const estimation::Vec3& towards_lamp);

// Outside directions by Lambert's law.
estimation::Vec3 lambertian_direction(PhotonRandom& random);

// reference/mc_truth_rf.csv at f = 0 and harmonics 1 to 4 and 6 of 12 mm, rounded as in the file.
inline constexpr double kTruthFreqs_per_mm[] = {0, 0.08, 0.17, 0.25, 0.33, 0.5};
struct TruthMedium {
  std::string name;
  Scattering scattering;
  double photons = 0;
  std::vector<double> reflectance;  // by kTruthFreqs_per_mm
  // Of the file, by kTruthFreqs_per_mm: each photon that leaves adds its weight times J0(k r), so
  // photons of our own walk say how far that scatters, to a few percent of it.
  std::vector<double> standard_error;
};
std::vector<TruthMedium> read_truth(const std::filesystem::path& file);

}  // namespace hw_sim
