#include "hw_sim/world/skin_kernel.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace hw_sim {

namespace {

constexpr double kTailFrac = 1e-4;
constexpr int kFractionBits = 20;
constexpr std::uint32_t kFractionMask = (1U << kFractionBits) - 1;
constexpr float kFractionScale = 1.0F / static_cast<float>(1U << kFractionBits);
const std::uint32_t kFirstBits =
    std::bit_cast<std::uint32_t>(std::ldexp(1.0F, RadialKnots::kFirstExponent));

}  // namespace

RadialKnots::Place RadialKnots::place_of(float r2) {
  const std::uint32_t bits = std::max(std::bit_cast<std::uint32_t>(r2), kFirstBits);
  const std::size_t knot = (bits - kFirstBits) >> kFractionBits;
  if (knot + 1 >= kCount) return {kCount - 2, 1};
  return {knot, static_cast<float>(bits & kFractionMask) * kFractionScale};
}

double RadialKnots::r2(std::size_t knot) {
  return static_cast<double>(
      std::bit_cast<float>(kFirstBits + (static_cast<std::uint32_t>(knot) << kFractionBits)));
}

// Hats are linear in r^2, and dA = pi d(r^2).
const std::array<double, RadialKnots::kCount>& RadialKnots::areas() {
  static const auto kAreas = [] {
    std::array<double, kCount> areas{};
    for (std::size_t k = 0; k < areas.size(); ++k) {
      const double below = k == 0 ? 0 : r2(k - 1);
      const double above = k + 1 < areas.size() ? r2(k + 1) : r2(k);
      areas[k] = std::numbers::pi * (above - below) / 2;
      if (k == 0) areas[k] += std::numbers::pi * r2(0) / 2;  // flat within the first knot
    }
    return areas;
  }();
  return kAreas;
}

SkinKernel::Ring SkinKernel::ring(std::size_t knot) const {
  Ring ring;
  ring.radius_mm = std::sqrt(RadialKnots::r2(knot) / static_cast<double>(scale2_));
  ring.area_mm2 = RadialKnots::areas()[knot] / static_cast<double>(scale2_);
  for (std::size_t i = 0; i < kTerms; ++i) ring.terms[i] = static_cast<double>(knots_[knot][i]);
  return ring;
}

float SkinKernel::at(float distance2_mm2, float x_mm, float y_mm) const {
  const RadialKnots::Place place = RadialKnots::place_of(distance2_mm2 * scale2_);
  const std::array<float, 8>& low = knots_[place.knot];
  const std::array<float, 8>& high = knots_[place.knot + 1];
  const auto term = [&](std::size_t i) { return low[i] + place.fraction * (high[i] - low[i]); };
  const float across2 = x_mm * x_mm + y_mm * y_mm;
  if (!(across2 > 0)) return term(0);
  const float inverse = 1 / std::sqrt(across2);
  const float c = x_mm * inverse, s = y_mm * inverse;
  return term(0) + c * term(1) + s * term(2) + (c * c - s * s) * term(3) + 2 * c * s * term(4);
}

SkinKernel SkinMaterial::kernel(const LightPath& path) const {
  const NodeWeights in = incidence_weights(path.incidence_rad), out = exit_weights(path.exit_rad);
  using Sums = std::array<float, kAngularStride>;
  std::array<Sums, SkinKernel::kKnots> sums{};
  for (std::size_t incidence = 0; incidence < kAngleNodes; ++incidence)
    for (std::size_t exit = 0; exit < kAngleNodes; ++exit) {
      Sums weights{};
      for (std::size_t i = 0; i < kAngularStride; ++i) weights[i] = in[incidence][i] * out[exit][i];
      const float* from = &orders_[index(incidence, exit, 0)];
      for (Sums& sum : sums) {
        for (std::size_t i = 0; i < kAngularStride; ++i) sum[i] += weights[i] * from[i];
        from += kAngularStride;
      }
    }
  const double scale2 = scattering_.sigma_s_prime_per_mm * scattering_.sigma_s_prime_per_mm;
  const double radiance = scale2 * typical_radiance(path.exit_rad);
  // cos(m a + k b) = cos(m a) cos(k b) - sin(m a) sin(k b).
  Sums cosines{}, sines{};
  for (std::size_t i = 0; i < kAngularOrders; ++i) {
    cosines[i] = static_cast<float>(radiance * std::cos(kOrders[i].k * path.exit_azimuth_rad));
    sines[i] = static_cast<float>(-radiance * std::sin(kOrders[i].k * path.exit_azimuth_rad));
  }
  SkinKernel kernel;
  kernel.scale2_ = static_cast<float>(scale2);
  const auto& areas = RadialKnots::areas();
  for (std::size_t knot = 0; knot < sums.size(); ++knot) {
    const auto sum = [&](const Sums& parts, std::size_t begin, std::size_t end) {
      float total = 0;
      for (std::size_t i = begin; i < end; ++i) total += parts[i] * sums[knot][i];
      return total;
    };
    static_assert(kOrders[3].m == 1 && kOrders[8].m == 2);
    kernel.knots_[knot] = {sum(cosines, 0, 3),
                           sum(cosines, 3, 8),
                           sum(sines, 3, 8),
                           sum(cosines, 8, 13),
                           sum(sines, 8, 13),
                           0,
                           0,
                           0};
    kernel.total_ += static_cast<double>(kernel.knots_[knot][0]) * areas[knot] / scale2;
  }
  double beyond = 0;
  std::size_t last = SkinKernel::kKnots - 1;
  while (last > 0 && beyond < kTailFrac * kernel.total_) {
    beyond += static_cast<double>(kernel.knots_[last][0]) * areas[last] / scale2;
    --last;
  }
  kernel.radius_mm_ = std::sqrt(RadialKnots::r2(last + 1) / scale2);
  return kernel;
}

}  // namespace hw_sim
