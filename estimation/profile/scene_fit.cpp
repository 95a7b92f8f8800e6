#include "estimation/profile/scene_fit.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "estimation/profile/band_sites.h"
#include "estimation/profile/lut_fit.h"
#include "estimation/profile/profile_match.h"
#include "estimation/profile/site_factors.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

constexpr std::size_t kPilotCount = 4000;  // sites that tell the range the scene occupies
constexpr double kReflectanceMargin = 0.05;
constexpr double kTranslucencyMargin = 1.5;
// The stripes must move a pixel by this many standard deviations of its noise, all shifts together.
constexpr double kLeastContrastSd = 10;
// A residual beyond this multiple of the noise, and this share of the mean, is not noise.
constexpr double kPoorFitNoise = 4;
constexpr double kPoorFitFrac = 0.03;
constexpr int kCurvePointsPerPx = 4;
// Of a sweep that lost samples to saturation, what must be left for the paper's method: with fewer
// its first R_d, from the mean of all, is too far off.
constexpr double kLeastSeenFrac = 0.5;

// DN/us of a perfect reflector at the site.
double full_signal_per_us(const BandRadiometry& radiometry, const SceneGeometry& geometry,
                          Site site) {
  return radiometry.signal_per_us * static_cast<double>(geometry.gain.at(site.row, site.col));
}

// One pixel at a time from the images' signals to its parameters. One per task.
class SiteFitter {
 public:
  SiteFitter(const CameraInfo& camera, const BandRadiometry& radiometry, const StripeSet& stripes,
             std::span<const ImageView<const float>> signals, const SceneGeometry& geometry,
             const HarmonicTransfer& transfer, int greatest_harmonic_count)
      : radiometry_(radiometry),
        stripes_(stripes),
        signals_(signals),
        geometry_(geometry),
        transfer_(transfer),
        channel_(channel_of(camera, radiometry.band)),
        whole_(stripes, greatest_harmonic_count),
        contrast_(static_cast<std::size_t>(greatest_harmonic_count), 1.0F) {}

  // Tries the tables in turn until one holds the material.
  LutFit fit(Site site, std::span<const ProfileTable* const> tables) {
    if (const std::uint32_t reason = load(site); reason != 0) return {.validity = reason};
    LutFit result;
    for (const ProfileTable* table : tables) {
      result = fit_with_table(matcher(), *table, radiometry_.projector_black_frac);
      if (result.validity == 0) break;
    }
    if (result.validity == 0 && is_poor(result)) result.validity |= kPoorFit;
    return result;
  }

 private:
  // Returns the reason if there is nothing to fit.
  std::uint32_t load(Site site) {
    samples_.clear();
    seen_.clear();
    double sum = 0;
    for (std::size_t i = 0; i < signals_.size(); ++i) {
      const auto sample = static_cast<double>(signals_[i].at(site.row, site.col, channel_));
      if (!std::isfinite(sample)) continue;
      samples_.push_back(sample);
      seen_.push_back(i);
      sum += sample;
    }
    if (static_cast<double>(seen_.size()) < kLeastSeenFrac * static_cast<double>(signals_.size()))
      return kSaturated;
    const double mean = sum / static_cast<double>(samples_.size());
    noise_variance_ = variance_at(radiometry_.noise, mean);
    double contrast = 0;
    for (const double sample : samples_) contrast += (sample - mean) * (sample - mean);
    if (!(mean > 0) || contrast < kLeastContrastSd * kLeastContrastSd * noise_variance_)
      return kTooDark;
    noise_frac_ = std::sqrt(noise_variance_) / mean;
    const double full = full_signal_per_us(radiometry_, geometry_, site);
    for (double& sample : samples_) sample /= full;
    if (!transfer_.is_perfect())
      transfer_.at(site.row, site.col, radiometry_.band,
                   static_cast<double>(geometry_.projector_distance_mm.at(site.row, site.col)),
                   stripes_.shape.period_px, contrast_);
    matcher().load(samples_, static_cast<double>(geometry_.position_px.at(site.row, site.col)),
                   contrast_);
    return 0;
  }

  bool is_whole() const { return seen_.size() == signals_.size(); }

  // Of the shifts seen. Neighbours tend to lose the same ones.
  ProfileMatcher& matcher() {
    if (is_whole()) return whole_;
    if (!partial_ || partial_seen_ != seen_) {
      StripeSet seen{.axis = stripes_.axis, .shape = stripes_.shape};
      for (const std::size_t i : seen_) seen.shifts_px.push_back(stripes_.shifts_px[i]);
      partial_.emplace(seen, static_cast<int>(contrast_.size()));
      partial_seen_ = seen_;
    }
    return *partial_;
  }

  bool is_poor(const LutFit& fit) const {
    return fit.rms_residual > kPoorFitNoise * noise_frac_ && fit.rms_residual > kPoorFitFrac;
  }

  const BandRadiometry& radiometry_;
  const StripeSet& stripes_;
  std::span<const ImageView<const float>> signals_;
  const SceneGeometry& geometry_;
  const HarmonicTransfer& transfer_;
  int channel_;
  ProfileMatcher whole_;
  std::optional<ProfileMatcher> partial_;
  std::vector<std::size_t> partial_seen_;  // what partial_ is for
  std::vector<double> samples_;            // those that were not lost
  std::vector<std::size_t> seen_;          // [sample] its shift's index
  std::vector<float> contrast_;
  double noise_variance_ = 0;  // of a sample at the mean, (DN/us)^2
  double noise_frac_ = 0;      // its root over the mean
};

// The range that the fits occupy, with a margin; nullopt if none succeeded.
std::optional<TableRange> occupied_range(std::span<const LutFit> fits, const TableRange& limits) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  TableRange range{kInfinity, -kInfinity, kInfinity, -kInfinity};
  for (const LutFit& fit : fits) {
    if ((fit.validity & kValidityErrors) != 0) continue;
    range.least_reflectance = std::min(range.least_reflectance, fit.diffuse_reflectance);
    range.greatest_reflectance = std::max(range.greatest_reflectance, fit.diffuse_reflectance);
    range.least_translucency_px = std::min(range.least_translucency_px, fit.translucency_px);
    range.greatest_translucency_px = std::max(range.greatest_translucency_px, fit.translucency_px);
  }
  if (!(range.least_reflectance <= range.greatest_reflectance)) return std::nullopt;
  return TableRange{
      .least_reflectance =
          std::max(range.least_reflectance - kReflectanceMargin, limits.least_reflectance),
      .greatest_reflectance =
          std::min(range.greatest_reflectance + kReflectanceMargin, limits.greatest_reflectance),
      .least_translucency_px =
          std::max(range.least_translucency_px / kTranslucencyMargin, limits.least_translucency_px),
      .greatest_translucency_px = std::min(range.greatest_translucency_px * kTranslucencyMargin,
                                           limits.greatest_translucency_px)};
}

BandFit empty_fit(const CameraInfo& camera, const SceneGeometry& geometry) {
  BandFit fit{.diffuse_reflectance = Image<float>(camera.height_px, camera.width_px, 1, kNan),
              .validity = Image<std::uint32_t>(camera.height_px, camera.width_px)};
  for (int row = 0; row < camera.height_px; ++row)
    std::copy_n(geometry.validity.row(row).begin(), camera.width_px,
                fit.validity.view().row(row).begin());
  return fit;
}

// r(shift) over one period: the material's share of the light on the stripe, indirect light, and
// projector black.
//   harmonics   c_n, of a profile whose mean over all phases is one
//   factors     f_n, n = 0, 1, ...
std::vector<ProfileSample> material_curve(StripeShape shape, std::span<const float> harmonics,
                                          std::span<const std::complex<double>> factors,
                                          double position_px, const SiteMaterial& found,
                                          double projector_black_frac) {
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  const double level = (duty + projector_black_frac) * factors[0].real() *
                       (found.diffuse_reflectance + found.indirect);
  std::vector<ProfileSample> curve;
  for (int i = 0; i < shape.period_px * kCurvePointsPerPx; ++i) {
    const double shift_px = static_cast<double>(i) / kCurvePointsPerPx;
    const double phase_rad =
        2 * std::numbers::pi *
        (position_px + found.phase_px - shift_px - 0.5 * (shape.width_px - 1)) / shape.period_px;
    double wave = 0;
    for (std::size_t n = 1; n <= harmonics.size(); ++n)
      wave += 2 * static_cast<double>(harmonics[n - 1]) *
              (factors[n] * std::polar(1.0, static_cast<double>(n) * phase_rad)).real();
    curve.push_back({shift_px, level + duty * found.diffuse_reflectance * wave});
  }
  return curve;
}

}  // namespace

BandFit fit_band(const CameraInfo& camera, const BandRadiometry& radiometry,
                 const StripeSet& stripes, std::span<const ImageView<const float>> signals,
                 const SceneGeometry& geometry, const HarmonicTransfer& transfer,
                 const ScatteringModel& model, const ProfileTable& wide) {
  const auto fitter = [&] {
    return SiteFitter(camera, radiometry, stripes, signals, geometry, transfer,
                      wide.greatest_harmonic_count());
  };
  const std::vector<Site> pilot =
      evenly_chosen(valid_sites(camera, radiometry.band, geometry.validity), kPilotCount);
  std::vector<LutFit> pilot_fits(pilot.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pilot.size(), 256), [&](const auto& range) {
    SiteFitter fit_site = fitter();
    const ProfileTable* tables[] = {&wide};
    for (std::size_t i = range.begin(); i != range.end(); ++i)
      pilot_fits[i] = fit_site.fit(pilot[i], tables);
  });
  const std::optional<TableRange> range = occupied_range(pilot_fits, wide.range());
  std::optional<ProfileTable> own;
  if (range) own.emplace(model, stripes.shape, *range);
  std::vector<const ProfileTable*> tables;
  if (own) tables.push_back(&*own);
  tables.push_back(&wide);

  BandFit fit = empty_fit(camera, geometry);
  fit.translucency_px = fit.diffuse_reflectance;
  fit.indirect = fit.diffuse_reflectance;
  tbb::parallel_for(tbb::blocked_range<int>(0, camera.height_px), [&](const auto& rows) {
    SiteFitter fit_site = fitter();
    for (int row = rows.begin(); row != rows.end(); ++row)
      for (int col = 0; col < camera.width_px; ++col) {
        if (!is_site(camera, radiometry.band, row, col)) continue;
        if ((geometry.validity.at(row, col) & kValidityErrors) != 0) continue;
        const LutFit found = fit_site.fit({row, col}, tables);
        fit.validity.at(row, col) |= found.validity;
        if ((found.validity & kValidityErrors) != 0) continue;
        fit.diffuse_reflectance.at(row, col) = static_cast<float>(found.diffuse_reflectance);
        fit.translucency_px.at(row, col) = static_cast<float>(found.translucency_px);
        fit.indirect.at(row, col) = static_cast<float>(found.indirect);
      }
  });
  fill_between_sites(camera, radiometry.band, geometry.validity, fit);
  return fit;
}

ProfileBand profile_of_site(const StripeScene& scene, const BandRadiometry& radiometry,
                            const SiteMaterial& found, double blur_px2) {
  const StripeShape shape = scene.stripes.shape;
  const Site site{found.row, found.col};
  const double position_px =
      static_cast<double>(scene.geometry.position_px.at(found.row, found.col));
  const std::vector<float> harmonics =
      profile_harmonics(scene.model, shape, found.diffuse_reflectance, found.translucency_px);
  SiteFactors site_factors(scene, radiometry.band, static_cast<int>(harmonics.size()), blur_px2);
  const std::span<const std::complex<double>> factors = site_factors.at(
      site,
      {.logit_reflectance = std::log(found.diffuse_reflectance / (1 - found.diffuse_reflectance)),
       .log_translucency_px = std::log(found.translucency_px)});
  // Oblique light moves the peak.
  const double moved_px = std::arg(factors[1]) * shape.period_px / (2 * std::numbers::pi);
  const double peak_px = position_px + found.phase_px + moved_px - 0.5 * (shape.width_px - 1);
  ProfileBand profile{.row = found.row,
                      .col = found.col,
                      .peak_px = peak_px - std::floor(peak_px / shape.period_px) * shape.period_px,
                      .diffuse_reflectance = found.diffuse_reflectance};
  const double full = full_signal_per_us(radiometry, scene.geometry, site);
  const int channel = channel_of(scene.camera, radiometry.band);
  std::vector<std::size_t> seen;  // [measured] how many samples its mean holds
  for (std::size_t i = 0; i < scene.signals.size(); ++i) {
    const double shift_px = static_cast<double>(scene.stripes.shifts_px[i]);
    const double reflectance =
        static_cast<double>(scene.signals[i].at(found.row, found.col, channel)) / full;
    if (!std::isfinite(reflectance)) continue;
    if (profile.measured.empty() || profile.measured.back().shift_px != shift_px) {
      profile.measured.push_back({shift_px, 0});
      seen.push_back(0);
    }
    double& mean = profile.measured.back().reflectance;
    mean += (reflectance - mean) / static_cast<double>(++seen.back());
  }
  profile.matched = material_curve(shape, harmonics, factors, position_px, found,
                                   radiometry.projector_black_frac);
  return profile;
}

BandFit reflectance_of_band(const CameraInfo& camera, const BandRadiometry& radiometry,
                            ImageView<const float> fully_lit, const SceneGeometry& geometry) {
  BandFit fit = empty_fit(camera, geometry);
  const int channel = channel_of(camera, radiometry.band);
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col) {
      if (!is_site(camera, radiometry.band, row, col)) continue;
      std::uint32_t& validity = fit.validity.at(row, col);
      if ((validity & kValidityErrors) != 0) continue;
      const double signal = static_cast<double>(fully_lit.at(row, col, channel));
      const double noise_sd = std::sqrt(variance_at(radiometry.noise, signal));
      const double reflectance = signal / (1 + radiometry.projector_black_frac) /
                                 full_signal_per_us(radiometry, geometry, {row, col});
      if (!std::isfinite(signal))
        validity |= kSaturated;
      else if (signal < kLeastContrastSd * noise_sd)
        validity |= kTooDark;
      else if (!(reflectance > 0 && reflectance <= 1))
        validity |= kOutsideModel;
      if ((validity & kValidityErrors) != 0) continue;
      validity |= kIndirectFixedAtZero;
      fit.diffuse_reflectance.at(row, col) = static_cast<float>(reflectance);
    }
  });
  fill_between_sites(camera, radiometry.band, geometry.validity, fit);
  return fit;
}

}  // namespace estimation
