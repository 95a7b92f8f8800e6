#include "estimation/profile/likelihood_maps.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "estimation/profile/coefficient_curve.h"
#include "estimation/profile/tilt_noise.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Of the reduced chi-square's own standard deviation, sqrt(2 / degrees of freedom).
constexpr double kPoorFitSd = 5;
// Of a pixel's mean: camera nonlinearity and the optics' transfer are not known better.
constexpr double kCalibrationFrac = 0.01;
// Noise told by the data's own scatter, or by what such cameras usually have: to this factor.
constexpr double kUnmeasuredNoise = 2;
constexpr std::size_t kFreeUnknowns = 4;

bool is_valid(const BatchFit& fit, std::size_t i) {
  return (fit.validity[i] & kValidityErrors) == 0;
}

double variance_of(const BatchFit& fit, std::size_t i, std::size_t row, std::size_t col) {
  return static_cast<double>(fit.covariance[covariance_index(row, col) * fit.stride + i]);
}

float root(double variance) { return static_cast<float>(std::sqrt(std::max(variance, 0.0))); }

// Of a value whose logarithm has the gradient (slope, -1) in t and ln l_d.
double variance_along(const BatchFit& fit, std::size_t i, double slope) {
  return slope * slope * variance_of(fit, i, 0, 0) - 2 * slope * variance_of(fit, i, 1, 0) +
         variance_of(fit, i, 1, 1);
}

// What carries the valid fits' covariance over to the coefficients.
struct Curves {
  CoefficientCurve coefficients;
  std::optional<TiltEffect> tilt;  // where the surface is not known exactly
};

std::optional<Curves> curves_over(const StripeScene& scene, const BandRadiometry& radiometry,
                                  const SiteFits& fits) {
  float least = std::numeric_limits<float>::infinity(), greatest = -least;
  double log_sum = 0, indirect_sum = 0, gain_sum = 0, count = 0;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if (!is_valid(fits.fit, i)) continue;
    least = std::min(least, fits.fit.logit_reflectance[i]);
    greatest = std::max(greatest, fits.fit.logit_reflectance[i]);
    log_sum += static_cast<double>(fits.fit.log_translucency_px[i]);
    indirect_sum += static_cast<double>(fits.fit.indirect[i]);
    gain_sum += static_cast<double>(scene.geometry.gain.at(fits.sites[i].row, fits.sites[i].col));
    count += 1;
  }
  if (count == 0) return std::nullopt;
  const double from = static_cast<double>(least), to = static_cast<double>(greatest);
  Curves curves{.coefficients = CoefficientCurve(scene.model, from, to), .tilt = {}};
  if (!scene.geometry.tilt.empty())
    curves.tilt.emplace(scene.model,
                        TypicalSite{.shape = scene.stripes.shape,
                                    .full_per_us = radiometry.signal_per_us * gain_sum / count,
                                    .translucency_px = std::exp(log_sum / count),
                                    .indirect = indirect_sum / count,
                                    .noise = radiometry.noise},
                        from, to);
  return curves;
}

class PoorFit {
 public:
  PoorFit(const BandRadiometry& radiometry, StripeShape shape, std::size_t sample_count,
          bool is_noise_measured)
      : radiometry_(radiometry),
        lit_frac_(static_cast<double>(shape.width_px) / shape.period_px +
                  radiometry.projector_black_frac) {
    const double freedom =
        std::max(1.0, static_cast<double>(sample_count) - static_cast<double>(kFreeUnknowns));
    noise_limit_ =
        (1 + kPoorFitSd * std::sqrt(2 / freedom)) * (is_noise_measured ? 1 : kUnmeasuredNoise);
  }

  //   reflectance     R_d + B
  //   full_per_us     DN/us of a perfect reflector
  bool operator()(double reduced_chi_square, double reflectance, double full_per_us) const {
    const double mean = lit_frac_ * reflectance * full_per_us;
    const double allowed = kCalibrationFrac * mean;
    return reduced_chi_square >
           noise_limit_ + allowed * allowed / variance_at(radiometry_.noise, mean);
  }

 private:
  const BandRadiometry& radiometry_;
  double lit_frac_, noise_limit_;
};

BandFit blank_maps(const SceneGeometry& geometry) {
  const int height = geometry.validity.height_px, width = geometry.validity.width_px;
  BandFit maps;
  for (Image<float>* image : maps.images()) *image = Image<float>(height, width, 1, kNan);
  maps.validity = Image<std::uint32_t>(height, width);
  for (int row = 0; row < height; ++row)
    std::copy_n(geometry.validity.row(row).begin(), width, maps.validity.view().row(row).begin());
  return maps;
}

}  // namespace

BandFit maps_of(const StripeScene& scene, const BandRadiometry& radiometry, const SiteFits& fits,
                const MapOptions& options) {
  BandFit maps = blank_maps(scene.geometry);
  const BatchFit& fit = fits.fit;
  const std::optional<Curves> curves = curves_over(scene, radiometry, fits);
  const PoorFit is_poor(radiometry, scene.stripes.shape, scene.stripes.shifts_px.size(),
                        options.is_noise_measured);
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, fits.sites.size(), 4096), [&](const auto& range) {
        for (std::size_t i = range.begin(); i != range.end(); ++i) {
          const auto [row, col] = fits.sites[i];
          maps.validity.at(row, col) |= fit.validity[i];
          if (!is_valid(fit, i)) continue;
          const double logit = static_cast<double>(fit.logit_reflectance[i]);
          const double reflectance = 1 / (1 + std::exp(-logit));
          const double indirect = static_cast<double>(fit.indirect[i]);
          const CoefficientCurve::At coefficients = curves->coefficients.at(logit);
          TiltVariances tilt;
          if (curves->tilt)
            tilt = curves->tilt->at(
                {.logit = logit, .is_indirect_free = variance_of(fit, i, 2, 2) > 0}, coefficients,
                {.along = static_cast<double>(scene.geometry.tilt.along.at(row, col)),
                 .across = static_cast<double>(scene.geometry.tilt.across.at(row, col))});
          maps.diffuse_reflectance.at(row, col) = static_cast<float>(reflectance);
          maps.translucency_px.at(row, col) =
              static_cast<float>(std::exp(static_cast<double>(fit.log_translucency_px[i])));
          maps.indirect.at(row, col) = fit.indirect[i];
          maps.phase_px.at(row, col) = fit.phase_px[i];
          maps.diffuse_reflectance_rel_sd.at(row, col) =
              root((1 - reflectance) * (1 - reflectance) * variance_of(fit, i, 0, 0) +
                   tilt.diffuse_reflectance);
          maps.translucency_rel_sd.at(row, col) =
              root(variance_of(fit, i, 1, 1) + tilt.translucency);
          maps.indirect_sd.at(row, col) = root(variance_of(fit, i, 2, 2) + tilt.indirect);
          maps.sigma_a_rel_sd.at(row, col) =
              root(variance_along(fit, i, coefficients.sigma_a.slope) + tilt.sigma_a);
          maps.sigma_s_prime_rel_sd.at(row, col) =
              root(variance_along(fit, i, coefficients.sigma_s_prime.slope) + tilt.sigma_s_prime);
          const double full_per_us =
              radiometry.signal_per_us * static_cast<double>(scene.geometry.gain.at(row, col));
          if (is_poor(static_cast<double>(fit.reduced_chi_square[i]), reflectance + indirect,
                      full_per_us))
            maps.validity.at(row, col) |= kPoorFit;
        }
      });
  fill_between_sites(scene.camera, radiometry.band, scene.geometry.validity, maps);
  return maps;
}

MisfitSummary misfit_of(const SiteFits& fits, const BandFit& maps) {
  MisfitSummary summary;
  std::vector<float> misfits;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if (!is_valid(fits.fit, i)) continue;
    misfits.push_back(fits.fit.reduced_chi_square[i]);
    if ((maps.validity.at(fits.sites[i].row, fits.sites[i].col) & kPoorFit) != 0)
      ++summary.poor_count;
  }
  summary.valid_count = misfits.size();
  if (misfits.empty()) return summary;
  const auto middle = misfits.begin() + static_cast<std::ptrdiff_t>(misfits.size() / 2);
  std::nth_element(misfits.begin(), middle, misfits.end());
  summary.median_reduced_chi_square = static_cast<double>(*middle);
  return summary;
}

}  // namespace estimation
