#include "tests/hw_sim/photons/half_space.h"

#include <math.h>  // j0, which <cmath> has as a slow std::cyl_bessel_j only

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

namespace {

void set_standard_errors(std::vector<TruthMedium>& media) {
  constexpr int kPhotons = 50'000;
  for (TruthMedium& medium : media) medium.standard_error.assign(medium.reflectance.size(), 0.0);
  PhotonRandom random(77);
  for (int photon = 0; photon < kPhotons; ++photon)
    walk_photon(0, random, [&](const PhotonExit& exit) {
      const double radius = std::hypot(exit.x, exit.y);  // in 1 / sigma_s'
      for (TruthMedium& medium : media) {
        const double scale = medium.scattering.sigma_s_prime_per_mm;
        const double kept = std::exp(-medium.scattering.sigma_a_per_mm / scale * exit.path_length);
        for (std::size_t i = 0; i < medium.standard_error.size(); ++i) {
          const double phase = 2 * std::numbers::pi * kTruthFreqs_per_mm[i] * radius / scale;
          medium.standard_error[i] += exit.weight * std::pow(kept * ::j0(phase), 2) / kPhotons;
        }
      }
    });
  for (TruthMedium& medium : media)
    for (std::size_t i = 0; i < medium.standard_error.size(); ++i)
      medium.standard_error[i] = std::sqrt(
          (medium.standard_error[i] - std::pow(medium.reflectance[i], 2)) / medium.photons);
}

}  // namespace

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
  set_standard_errors(media);
  return media;
}

}  // namespace hw_sim
