#include "estimation/models/dipole.h"

#include <cmath>
#include <limits>

#include "estimation/base/check.h"
#include "estimation/models/source_pair.h"

namespace estimation {
namespace {

const double kLargestS = std::sqrt(3.0);

// (1 + exp(-4/3 A Q)) exp(-Q) / 2: both sources of the dipole at attenuation Q.
double source_pair(double boundary, double q) {
  return 0.5 * (1 + std::exp(-4.0 / 3.0 * boundary * q)) * std::exp(-q);
}

// d/dQ of source_pair.
double source_pair_slope(double boundary, double q) {
  const double virtual_source = std::exp(-4.0 / 3.0 * boundary * q);
  return -0.5 * (1 + virtual_source * (1 + 4.0 / 3.0 * boundary)) * std::exp(-q);
}

}  // namespace

double boundary_factor(double eta) {
  const double reflected = -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta;
  return (1 + reflected) / (1 - reflected);
}

double Dipole::reflectance_at(double s) const {
  return (1 - s * s / 3) * source_pair(boundary_, s);
}

double Dipole::s_at(double diffuse_reflectance) const {
  if (!(diffuse_reflectance >= 0 && diffuse_reflectance <= 1))
    return std::numeric_limits<double>::quiet_NaN();
  if (diffuse_reflectance == 1) return 0;
  if (diffuse_reflectance == 0) return kLargestS;
  // Newton inside a bracket that every step shrinks; a step that leaves it becomes a bisection.
  double low = 0, high = kLargestS;  // reflectance(low) > target > reflectance(high)
  double s = kLargestS * (1 - diffuse_reflectance);
  for (int step = 0; step < 200; ++step) {
    const double excess = reflectance_at(s) - diffuse_reflectance;
    if (excess == 0) return s;
    (excess > 0 ? low : high) = s;
    const double slope =
        -2 * s / 3 * source_pair(boundary_, s) + (1 - s * s / 3) * source_pair_slope(boundary_, s);
    double next = s - excess / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == s || std::abs(next - s) <= 1e-16 * s) return next;
    s = next;
  }
  return s;
}

void Dipole::transform(double diffuse_reflectance, std::span<const double> k_times_l_d,
                       std::span<double> out) const {
  check(k_times_l_d.size() == out.size(), "one value of R~ for each frequency");
  const double s = s_at(diffuse_reflectance);
  source_pairs(1 - s * s / 3, s, 1 + 4.0 / 3.0 * boundary_, k_times_l_d, out);
}

Coefficients Dipole::coefficients(double diffuse_reflectance, double translucency_mm) const {
  // Eq. 6: sigma_t' = 1 / (l_d s); sigma_a = (1 - alpha') sigma_t' = s^2/3 sigma_t'.
  const double s = s_at(diffuse_reflectance);
  return {.sigma_a_per_mm = s / (3 * translucency_mm),
          .sigma_s_prime_per_mm = (1 - s * s / 3) / (translucency_mm * s)};
}

double dipole_reflectance(const Coefficients& medium, double eta) {
  const double extinction = medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm;
  return Dipole(eta).reflectance_at(std::sqrt(3 * medium.sigma_a_per_mm / extinction));
}

double diffuse_mean_free_path_mm(const Coefficients& medium) {
  return 1 / std::sqrt(3 * medium.sigma_a_per_mm *
                       (medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm));
}

}  // namespace estimation
