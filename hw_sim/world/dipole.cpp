#include "hw_sim/world/dipole.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace hw_sim {

namespace {

// (1 + F_dr) / (1 - F_dr) at eta 1.4: the paper's boundary.
double boundary_a() {
  constexpr double kEta = 1.4;
  const double f_dr = -1.440 / (kEta * kEta) + 0.710 / kEta + 0.668 + 0.0636 * kEta;
  return (1 + f_dr) / (1 - f_dr);
}

}  // namespace

double Scattering::translucency_mm() const {
  return 1 / std::sqrt(3 * sigma_a_per_mm * (sigma_a_per_mm + sigma_s_prime_per_mm));
}

Dipole::Dipole(const Scattering& scattering) {
  const double extinction = scattering.sigma_a_per_mm + scattering.sigma_s_prime_per_mm;
  albedo_ = scattering.sigma_s_prime_per_mm / extinction;
  sigma_tr_ = std::sqrt(3 * scattering.sigma_a_per_mm * extinction);
  z_r_ = 1 / extinction;
  z_v_ = z_r_ * (1 + 4.0 / 3.0 * boundary_a());
}

double Dipole::reflectance_per_mm2(double radius_mm) const {
  const auto pole = [&](double z) {
    const double d = std::hypot(radius_mm, z);
    return z * (sigma_tr_ + 1 / d) * std::exp(-sigma_tr_ * d) / (d * d);
  };
  return albedo_ / (4 * std::numbers::pi) * (pole(z_r_) + pole(z_v_));
}

double Dipole::reflectance_beyond(double radius_mm) const {
  // -d/dr (exp(-s d) / d) = (s + 1/d) exp(-s d) r / d^2: each pole of eq. 3 integrates in closed
  // form.
  const auto pole = [&](double z) {
    const double d = std::hypot(radius_mm, z);
    return z * std::exp(-sigma_tr_ * d) / d;
  };
  return albedo_ / 2 * (pole(z_r_) + pole(z_v_));
}

double Dipole::radius_with_tail_mm(double tail_frac) const {
  const double wanted = tail_frac * total_reflectance();
  double low = 0, high = 1;
  while (reflectance_beyond(high) > wanted && high < 1000) high *= 2;
  for (int i = 0; i < 40; ++i) {
    const double middle = (low + high) / 2;
    (reflectance_beyond(middle) > wanted ? low : high) = middle;
  }
  return high;
}

KernelTable::KernelTable(const Dipole& dipole, double radius_mm)
    : depth2_(static_cast<float>(dipole.real_depth_mm() * dipole.real_depth_mm())),
      radius2_(static_cast<float>(radius_mm * radius_mm)) {
  first_bits_ = std::bit_cast<std::uint32_t>(depth2_) & ~kFractionMask;
  const std::uint32_t last_bits = std::bit_cast<std::uint32_t>(radius2_ + depth2_);
  const std::size_t count = ((last_bits - first_bits_) >> kFractionBits) + 2;
  values_.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto bits = first_bits_ + (static_cast<std::uint32_t>(i) << kFractionBits);
    // The first knot may lie just below r = 0; the kernel is analytic in r^2, so continue it.
    const double r2 =
        static_cast<double>(std::bit_cast<float>(bits)) - static_cast<double>(depth2_);
    if (r2 >= 0) values_[i] = static_cast<float>(dipole.reflectance_per_mm2(std::sqrt(r2)));
  }
  const double below =
      static_cast<double>(depth2_) - static_cast<double>(std::bit_cast<float>(first_bits_));
  if (below > 0) {
    const double step = 1e-3 * static_cast<double>(depth2_);
    const double slope =
        (dipole.reflectance_per_mm2(std::sqrt(step)) - dipole.reflectance_per_mm2(0)) / step;
    values_[0] = static_cast<float>(dipole.reflectance_per_mm2(0) - slope * below);
  }
}

}  // namespace hw_sim
