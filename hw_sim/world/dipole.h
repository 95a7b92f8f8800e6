// Subsurface scattering in space, as the simulator computes it: the dipole of Tariq et al. 2006,
// eq. 3, integrated over the lit surface. The estimator has its own code in the frequency domain.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

namespace hw_sim {

// Which physics a world follows.
enum class ScatteringModel { kMonteCarlo, kDipole };

struct Scattering {
  double sigma_a_per_mm = 0;
  double sigma_s_prime_per_mm = 0;
  bool operator==(const Scattering&) const = default;
  double translucency_mm() const;  // l_d, eq. 6
};

// R_d of a material, whichever the physics.
using TotalReflectance = std::function<double(const Scattering&)>;

class Dipole {
 public:
  explicit Dipole(const Scattering& scattering);       // eta 1.4
  double reflectance_per_mm2(double radius_mm) const;  // eq. 3
  double reflectance_beyond(double radius_mm) const;   // its integral from radius_mm to infinity
  double total_reflectance() const { return reflectance_beyond(0); }  // eq. 5
  double radius_with_tail_mm(double tail_frac) const;  // where that much of the total remains
  double real_depth_mm() const { return z_r_; }

 private:
  double albedo_, sigma_tr_, z_r_, z_v_;
};

// The same kernel over squared distance, for inner loops: logarithmic in r^2 + z_r^2 by means of
// the bits of a float, 64 steps an octave, linear between; off by less than
// 1e-3 of its value in the far tail, 2e-4 near.
class KernelTable {
 public:
  KernelTable() = default;
  KernelTable(const Dipole& dipole, double radius_mm);
  float radius2_mm2() const { return radius2_; }
  float at(float distance2_mm2) const {  // distance2 < radius2
    const auto bits = std::bit_cast<std::uint32_t>(distance2_mm2 + depth2_);
    const std::size_t i = (bits - first_bits_) >> kFractionBits;
    const float fraction = static_cast<float>(bits & kFractionMask) * kFractionScale;
    return values_[i] + fraction * (values_[i + 1] - values_[i]);
  }

 private:
  static constexpr int kFractionBits = 17;  // of the 23 of a float's mantissa
  static constexpr std::uint32_t kFractionMask = (1U << kFractionBits) - 1;
  static constexpr float kFractionScale = 1.0F / static_cast<float>(1U << kFractionBits);
  std::vector<float> values_;
  std::uint32_t first_bits_ = 0;
  float depth2_ = 0;
  float radius2_ = 0;
};

}  // namespace hw_sim
