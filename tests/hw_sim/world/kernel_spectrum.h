// What a tabulated kernel does to stripes, and the flat phantoms of tests/data/mc_tilted.csv,
// walked by a third program: by direction of incidence and exit.
#pragma once

#include <math.h>  // j0, which <cmath> has as a slow std::cyl_bessel_j only

#include <cmath>
#include <complex>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/white_walk.h"

namespace hw_sim {

using Rings = std::vector<SkinKernel::Ring>;

inline Rings rings_of(const SkinKernel& kernel) {
  Rings rings;
  for (std::size_t knot = 0; knot < SkinKernel::kKnots; ++knot) rings.push_back(kernel.ring(knot));
  return rings;
}

// The integral of K exp(2 pi i f (offset along the way in)) over the plane. K is linear in r^2
// between knots, as SkinKernel::at() has it. The wave is not: where light goes far, knots lie a
// third of its length apart, and a sum of it at the knots is off by 1% at six stripes per 12 mm.
inline std::complex<double> transform(const Rings& rings, double freq_per_mm) {
  constexpr double kMostPhase = 0.1;  // from one ring of the sum to the next
  const double per_mm = 2 * std::numbers::pi * freq_per_mm;
  std::complex<double> sum = 0;
  const auto add = [&](double radius_mm, double area_mm2, const auto& term) {
    const double phase = per_mm * radius_mm;
    // Integrals over the circle of cos(m a) exp(i phase cos a): Bessel functions.
    sum += area_mm2 * (term(0) * ::j0(phase) + std::complex<double>(0, 1) * term(1) * ::j1(phase) -
                       term(3) * ::jn(2, phase));
  };
  const auto r2 = [&](std::size_t knot) { return std::pow(rings[knot].radius_mm, 2); };
  add(rings[0].radius_mm / std::numbers::sqrt2, std::numbers::pi * r2(0),
      [&](std::size_t i) { return rings[0].terms[i]; });
  for (std::size_t knot = 0; knot + 1 < rings.size(); ++knot) {
    const SkinKernel::Ring &low = rings[knot], &high = rings[knot + 1];
    const double steps = std::ceil(per_mm * (high.radius_mm - low.radius_mm) / kMostPhase + 1);
    for (double step = 0.5; step < steps; ++step) {
      const double share = step / steps;
      add(std::sqrt(r2(knot) + share * (r2(knot + 1) - r2(knot))),
          std::numbers::pi * (r2(knot + 1) - r2(knot)) / steps,
          [&](std::size_t i) { return low.terms[i] + share * (high.terms[i] - low.terms[i]); });
    }
  }
  return sum;
}

// Lambert's cosine over the exits: the mean over their angles, weighed, and over azimuths.
inline Rings over_all_exits(const SkinMaterial& material, double incidence_rad, int exits,
                            int azimuths) {
  Rings mean(SkinKernel::kKnots);
  const double step_rad = std::numbers::pi / 2 / exits;
  for (int i = 0; i < exits; ++i)
    for (int side = 0; side < azimuths; ++side) {
      const double exit_rad = (i + 0.5) * step_rad;
      const Rings rings = rings_of(
          material.kernel({.incidence_rad = incidence_rad,
                           .exit_rad = exit_rad,
                           .exit_azimuth_rad = (side + 0.5) * 2 * std::numbers::pi / azimuths}));
      const double share = std::sin(2 * exit_rad) * step_rad / azimuths;
      for (std::size_t knot = 0; knot < rings.size(); ++knot) {
        mean[knot].radius_mm = rings[knot].radius_mm;
        mean[knot].area_mm2 = rings[knot].area_mm2;
        for (std::size_t term = 0; term < rings[knot].terms.size(); ++term)
          mean[knot].terms[term] += rings[knot].terms[term] * share;
      }
    }
  return mean;
}

// Light travels along +x; the eye is at `exit_azimuth_rad` from there.
struct TiltedPhantom {
  std::string medium;
  Scattering scattering;
  double cos_incidence = 1, cos_exit = 1, exit_azimuth_rad = 0;
  std::vector<double> freqs_per_mm;          // of harmonics from 0 on
  std::vector<std::complex<double>> values;  // pi times the radiance over the incident flux
  std::vector<double> standard_errors;       // of real or imaginary part
};

inline std::vector<TiltedPhantom> read_tilted(const std::filesystem::path& path) {
  std::vector<TiltedPhantom> phantoms;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#' || line.starts_with("medium")) continue;
    for (char& c : line)
      if (c == ',') c = ' ';
    std::istringstream row(line);
    TiltedPhantom phantom;
    double incidence_azimuth_rad = 0, harmonic = 0, freq_per_mm = 0, re = 0, im = 0, se = 0;
    row >> phantom.medium >> phantom.scattering.sigma_a_per_mm >>
        phantom.scattering.sigma_s_prime_per_mm >> phantom.cos_incidence >> incidence_azimuth_rad >>
        phantom.cos_exit >> phantom.exit_azimuth_rad >> harmonic >> freq_per_mm >> re >> im >> se;
    if (harmonic == 0) phantoms.push_back(phantom);
    phantoms.back().freqs_per_mm.push_back(freq_per_mm);
    phantoms.back().values.emplace_back(re, im);
    phantoms.back().standard_errors.push_back(se);
  }
  return phantoms;
}

// What the table says of a phantom's harmonics.
inline std::vector<std::complex<double>> harmonics_of(const ScatterTable& table,
                                                      const TiltedPhantom& phantom) {
  const Rings rings =
      rings_of(table.kernel(phantom.scattering, {.incidence_rad = std::acos(phantom.cos_incidence),
                                                 .exit_rad = std::acos(phantom.cos_exit),
                                                 .exit_azimuth_rad = phantom.exit_azimuth_rad}));
  const double entering = 1 - fresnel_reflectance(phantom.cos_incidence, 1, kSkinIndex);
  std::vector<std::complex<double>> values;
  // Light that is seen at x entered at x less the offset.
  for (const double freq_per_mm : phantom.freqs_per_mm)
    values.push_back(entering * std::conj(transform(rings, freq_per_mm)));
  return values;
}

}  // namespace hw_sim
