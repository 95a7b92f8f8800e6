#include "tests/hw_sim/photons/half_space.h"

#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>

namespace hw_sim {

using estimation::Vec3;

const ShapeGrid& half_space() {
  static const HalfSpace shape;
  static const ShapeGrid grid(shape, {{-15, -15, -1}, {15, 15, 10}}, 0.5);
  return grid;
}

Vec3 outward(double angle_rad, double azimuth_rad) {
  const double sine = std::sin(angle_rad);
  return {sine * std::cos(azimuth_rad), sine * std::sin(azimuth_rad), -std::cos(angle_rad)};
}

Lamp sunlight(const Vec3& towards_lamp) {
  constexpr double kFarMm = 1e6;
  return {kFarMm * towards_lamp, kFarMm * kFarMm};
}

Vec3 lambertian_direction(PhotonRandom& random) {
  const double sine2 = random.uniform(), azimuth = 2 * std::numbers::pi * random.uniform();
  const double sine = std::sqrt(sine2);
  return {sine * std::cos(azimuth), sine * std::sin(azimuth), -std::sqrt(1 - sine2)};
}

double TruthMedium::standard_error(std::size_t freq) const {
  return std::sqrt(reflectance[freq] / photons);
}

std::vector<TruthMedium> read_truth(const std::filesystem::path& file) {
  std::vector<TruthMedium> media;
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    if (line.empty() || line[0] == '#' || line.starts_with("name")) continue;
    for (char& c : line)
      if (c == ',') c = ' ';
    std::istringstream row(line);
    TruthMedium medium;
    double freq_per_mm = 0, reflectance = 0;
    row >> medium.name >> medium.scattering.sigma_a_per_mm >>
        medium.scattering.sigma_s_prime_per_mm >> medium.photons >> freq_per_mm >> reflectance;
    for (const double wanted : kTruthFreqs_per_mm) {
      if (std::abs(freq_per_mm - wanted) > 1e-6) continue;
      if (media.empty() || media.back().name != medium.name) media.push_back(medium);
      media.back().reflectance.push_back(reflectance);
    }
  }
  return media;
}

}  // namespace hw_sim
