#include "estimation/profile/site_factors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace estimation {
namespace {

using std::numbers::pi;

double sample(ImageView<const float> image, Site site) {
  return static_cast<double>(image.at(site.row, site.col));
}

}  // namespace

Directionality directionality_of(const ScatteringModel& model) {
  const std::array<double, 3> k_times_l_d{0, 0.5, 2};
  std::array<std::complex<double>, 3> factors;
  model.direction_factors(
      0.5, k_times_l_d,
      {.cos_incidence = 0.7, .cos_exit = 0.8, .incidence_azimuth_rad = 0.3, .exit_azimuth_rad = 2},
      factors);
  Directionality found;
  for (const std::complex<double>& factor : factors) {
    found.has_factors = found.has_factors || factor != std::complex<double>(1, 0);
    found.has_shift = found.has_shift || factor.imag() != 0;
    found.is_flat = found.is_flat && factor == factors[0];
  }
  return found;
}

SiteFactors::SiteFactors(const StripeScene& scene, int band, int harmonic_count, double blur_px2)
    : scene_(scene),
      band_(band),
      is_uniform_(scene.transfer.is_uniform()),
      is_perfect_(scene.transfer.is_perfect() && blur_px2 == 0),
      contrast_(static_cast<std::size_t>(harmonic_count), 1.0F) {
  if (!scene.geometry.directions.empty()) direction_ = directionality_of(scene.model);
  const auto count = static_cast<std::size_t>(harmonic_count) + 1;
  const double period = scene.stripes.shape.period_px;
  for (std::size_t n = 0; n < count; ++n)
    blur_.push_back(
        std::exp(-2 * pi * pi * blur_px2 * static_cast<double>(n * n) / (period * period)));
  k_times_l_d_.resize(count);
  light_.assign(count, {1, 0});
  factors_.assign(count, {1, 0});
  if (is_uniform_) scene.transfer.at(0, 0, band, 0, scene.stripes.shape.period_px, contrast_);
}

std::span<const std::complex<double>> SiteFactors::at(Site site, ShapePoint material) {
  const SceneGeometry& geometry = scene_.geometry;
  const int period_px = scene_.stripes.shape.period_px;
  if (!is_uniform_)
    scene_.transfer.at(site.row, site.col, band_, sample(geometry.projector_distance_mm, site),
                       period_px, contrast_);
  if (direction_.has_factors) {
    const double l_d_px = std::exp(material.log_translucency_px);
    for (std::size_t n = 0; n < k_times_l_d_.size(); ++n)
      k_times_l_d_[n] = 2 * pi * static_cast<double>(n) / period_px * l_d_px;
    const SceneDirections& to = geometry.directions;
    const std::size_t count = direction_.is_flat ? 1 : light_.size();
    scene_.model.direction_factors(1 / (1 + std::exp(-material.logit_reflectance)),
                                   std::span(k_times_l_d_).first(count),
                                   {.cos_incidence = sample(to.cos_incidence, site),
                                    .cos_exit = sample(to.cos_exit, site),
                                    .incidence_azimuth_rad = sample(to.incidence_azimuth_rad, site),
                                    .exit_azimuth_rad = sample(to.exit_azimuth_rad, site)},
                                   std::span(light_).first(count));
    if (direction_.is_flat) std::fill(light_.begin() + 1, light_.end(), light_[0]);
  }
  factors_[0] = light_[0];
  for (std::size_t n = 1; n < factors_.size(); ++n)
    factors_[n] = light_[n] * (blur_[n] * static_cast<double>(contrast_[n - 1]));
  return factors_;
}

}  // namespace estimation
