#include "hw_sim/world/sensor.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace hw_sim {

namespace {

// Steele and Vigna's mix (splitmix64): one step is a good hash of a counter.
std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15U;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9U;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBU;
  return x ^ (x >> 31);
}

// (0, 1), 32 bits of resolution, never an end point.
double to_unit(std::uint64_t bits32) { return (static_cast<double>(bits32) + 0.5) * 0x1p-32; }

// Standard normal quantile; Wichura, Applied Statistics 37 (1988), AS 241, PPND7: 1e-7.
double normal_quantile(double p) {
  const double q = p - 0.5;
  if (std::abs(q) <= 0.425) {
    const double r = 0.180625 - q * q;
    return q * (((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179) /
           (((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0);
  }
  double r = std::sqrt(-std::log(q < 0 ? p : 1 - p));
  double z = 0;
  if (r <= 5) {
    r -= 1.6;
    z = (((0.17023821103 * r + 1.3067284816) * r + 2.7568153900) * r + 1.4234372777) /
        ((0.12021132975 * r + 0.73700164250) * r + 1.0);
  } else {
    r -= 5;
    z = (((0.017337203 * r + 0.42868294337) * r + 3.0812263860) * r + 6.6579051150) /
        ((0.012258202635 * r + 0.24197894225) * r + 1.0);
  }
  return q < 0 ? -z : z;
}

// Poisson by inversion of its distribution function, exact to the uniform's resolution.
double poisson_count(double mean, double uniform) {
  double term = std::exp(-mean), sum = term;
  int count = 0;
  while (uniform > sum && count < 1000) {
    ++count;
    term *= mean / count;
    sum += term;
  }
  return count;
}

// What a pixel is, whatever it sees.
struct PixelMake {
  double gain = 1, offset_dn = 0, dark_dn = 0;
};

PixelMake pixel_make(const SensorModel& sensor, std::int64_t sample, double exposure_s) {
  constexpr std::uint64_t kStream = 0x5EED0F7115A11CE5U;  // apart from the noise's
  const std::uint64_t a = mixed(mixed(sensor.seed ^ kStream) +
                                static_cast<std::uint64_t>(sample) * 0xD1342543DE82EF95U);
  const std::uint64_t b = mixed(a);
  PixelMake make;
  make.gain =
      std::max(0.0, 1 + sensor.pixel_gain_sd_frac * normal_quantile(to_unit(a & 0xFFFFFFFFU)));
  make.offset_dn = sensor.pixel_offset_sd_dn * normal_quantile(to_unit(a >> 32));
  if (to_unit(b & 0xFFFFFFFFU) < sensor.hot_pixel_frac)
    make.dark_dn = -std::log(to_unit(b >> 32)) * sensor.hot_pixel_dn_per_s * exposure_s;
  return make;
}

}  // namespace

void SensorModel::digitise(const float* signal_dn, std::uint64_t trigger_number,
                           std::int64_t first_sample, std::int64_t count, std::uint16_t* frame_dn,
                           double exposure_s) const {
  // Above this mean a normal variable with Poisson's variance and skewness differs from Poisson by
  // less than its steps.
  constexpr double kManyElectrons = 30;
  const std::uint64_t stream = mixed(seed ^ mixed(trigger_number));
  const double read_variance = read_noise_e * read_noise_e;
  const double dn_per_e = 1 / gain_e_per_dn;
  const double well_e = full_well_e > 0 ? full_well_e : std::numeric_limits<double>::infinity();
  for (std::int64_t i = 0; i < count; ++i) {
    const std::uint64_t random =
        mixed(stream + static_cast<std::uint64_t>(first_sample + i) * 0xD1342543DE82EF95U);
    const double z = normal_quantile(to_unit(random & 0xFFFFFFFFU));
    const PixelMake make =
        has_fixed_pattern() ? pixel_make(*this, first_sample + i, exposure_s) : PixelMake{};
    const double mean_e =
        (static_cast<double>(signal_dn[i]) * make.gain + make.dark_dn) * gain_e_per_dn;
    double electrons = 0;
    if (mean_e >= kManyElectrons) {
      const double variance = mean_e + read_variance, sd = std::sqrt(variance);
      const double skewness = mean_e / (variance * sd);
      electrons = mean_e + sd * (z + skewness * (z * z - 1) / 6);
    } else {
      electrons = read_noise_e * z;
      if (mean_e > 0) electrons += poisson_count(mean_e, to_unit(random >> 32));
    }
    electrons = std::min(electrons, well_e);
    const double dn = std::floor(black_level_dn + make.offset_dn + electrons * dn_per_e + 0.5);
    frame_dn[i] = static_cast<std::uint16_t>(std::clamp(dn, 0.0, static_cast<double>(adc_max_dn)));
  }
}

}  // namespace hw_sim
