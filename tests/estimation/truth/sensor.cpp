#include "tests/estimation/truth/sensor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace estimation::truth {

PixelRandom::result_type PixelRandom::operator()() {
  state_ += 0x9e3779b97f4a7c15U;
  std::uint64_t z = state_;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9U;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebU;
  return z ^ (z >> 31);
}

double PixelRandom::normal() {
  const double radius = std::sqrt(-2 * std::log(1 - uniform()));
  return radius * std::cos(2 * std::numbers::pi * uniform());
}

double PixelRandom::poisson(double mean) {
  if (!(mean > 0)) return 0;
  return static_cast<double>(std::poisson_distribution<std::int64_t>(mean)(*this));
}

std::vector<MergedNoise> Sensor::noise() const {
  return merged_noise({short_us, long_us},
                      {.gain_e_per_dn = gain_e_per_dn(), .read_noise_e = read_noise_e},
                      saturation_dn - black_dn);
}

double Sensor::read(double reflectance_factor, PixelRandom& random) const {
  double sum_dn = 0, sum_us = 0;
  for (const double exposure_us : {short_us, long_us}) {
    const double mean_e =
        std::max(reflectance_factor, 0.0) * full_signal_dn_per_us() * exposure_us * gain_e_per_dn();
    const double seen_e = mean_e * (1 - nonlinearity_frac * mean_e / full_well_e);
    const double signal_e =
        is_noisy ? random.poisson(seen_e) + read_noise_e * random.normal() : seen_e;
    double dn = black_dn + signal_e / gain_e_per_dn();
    if (is_noisy && is_quantised) dn = std::round(dn);
    dn = std::clamp(dn, 0.0, saturation_dn);
    if (dn >= saturation_dn) continue;
    sum_dn += dn - black_dn;
    sum_us += exposure_us;
  }
  return sum_us > 0 ? sum_dn / sum_us : std::numeric_limits<double>::quiet_NaN();
}

std::vector<double> sweep(const PeriodicCurve& curve, StripeShape shape,
                          std::span<const int> shifts_px, const View& view,
                          std::span<const int> order) {
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  const double total = curve.mean() / duty;  // R_d
  const double count = static_cast<double>(shifts_px.size());
  std::vector<double> factors;
  for (std::size_t i = 0; i < shifts_px.size(); ++i) {
    const double place = order.empty() ? static_cast<double>(i) : order[i];
    const double moved_px = view.drift_px * (count > 1 ? place / (count - 1) - 0.5 : 0);
    const double x_px = view.u_px + moved_px - shifts_px[i] - 0.5 * (shape.width_px - 1);
    const double direct = curve(x_px) + view.projector_black_frac * total;
    const double indirect = (duty + view.projector_black_frac) * view.indirect;
    factors.push_back(view.gain * (direct + indirect) + view.ambient);
  }
  return factors;
}

}  // namespace estimation::truth
