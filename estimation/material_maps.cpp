#include "estimation/material_maps.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <limits>
#include <sstream>
#include <utility>
#include <variant>

#include "estimation/capture_order.h"
#include "estimation/lit_geometry.h"
#include "estimation/profile/chance_fits.h"
#include "estimation/profile/coefficient_curve.h"
#include "estimation/profile/indirect_choice.h"
#include "estimation/profile/likelihood_maps.h"
#include "estimation/profile/likelihood_scene.h"
#include "estimation/profile/profile_table.h"
#include "estimation/profile/scene_fit.h"
#include "estimation/profile/site_factors.h"
#include "estimation/profile/sweep_errors.h"
#include "estimation/stripe_signals.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Noise alone gives 1; calibrations of a real rig leave some. The dipole on Monte Carlo truth: 8.
constexpr double kSuspectChiSquare = 2;
// Of the fits: then it is the capture, not single pixels, that tells too little.
constexpr double kManyUntold = 0.5;

std::string fixed(double value, int digits) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(digits) << value;
  return text.str();
}

std::string band_name(int band, int bands) {
  return bands == 1 ? "Y" : std::string(1, "RGB"[band]);
}

// Share of the sites with light enough for a fit whose unknowns it did not tell apart.
double untold_frac_of(const SiteFits& fits) {
  std::size_t told = 0, untold = 0;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    const std::uint32_t errors = fits.fit.validity[i] & kValidityErrors;
    if (errors == 0) ++told;
    if ((errors & kNotIdentifiable) != 0) ++untold;
  }
  return untold == 0 ? 0 : static_cast<double>(untold) / static_cast<double>(told + untold);
}

class MaterialEstimate {
 public:
  MaterialEstimate(const MaterialInput& input, Maps& maps) : in_(input), maps_(maps) {}

  MaterialResult run();

 private:
  const CameraInfo& camera() const { return in_.manifest.camera; }
  int bands() const { return band_count(camera().pixel_format.filter); }

  const PatternRate* fully_lit() const;
  const Image<float>& pitch_mm() const { return lit_->pitch_mm(); }
  const SceneGeometry& geometry() const { return lit_->geometry(); }
  void reflectance_only(const PatternRate* white);
  void fit_by_table(const StripeScene& scene);
  void fit_by_likelihood(const StripeScene& scene);
  SweepCorrection sweep_correction(const StripeScene& scene, std::span<const BandLikelihood> bands);
  void note_choices(std::size_t valid_count, std::size_t fixed_count);
  void note_untold(StripeShape shape, const std::vector<double>& untold_frac);
  void note_misfit(const std::vector<MisfitSummary>& bands_misfit);
  void store_band(int band, BandFit fit);
  Image<float> own_phases() const;
  std::vector<ProfilePoint> profiles_of(const StripeScene& scene) const;

  const MaterialInput& in_;
  Maps& maps_;
  MaterialResult result_;
  std::optional<LitGeometry> lit_;        // along the axis that the stripes ran over
  std::array<Image<float>, 3> phase_px_;  // [band] of the likelihood fits
  double blur_px2_ = 0;
};

const PatternRate* MaterialEstimate::fully_lit() const {
  for (const PatternRate& pattern : in_.signals.patterns)
    if (std::holds_alternative<White>(pattern.pattern->kind)) return &pattern;
  return nullptr;
}

// Pixels without a fit are moved as their neighbours are, lest the surface have steps there: the
// mean over 7 x 7, zero where that holds nothing.
Image<float> without_gaps(const Image<float>& phases) {
  constexpr int kReachPx = 3;
  Image<float> filled = phases;
  tbb::parallel_for(0, phases.height_px(), [&](int row) {
    for (int col = 0; col < phases.width_px(); ++col) {
      if (std::isfinite(phases.at(row, col))) continue;
      float sum = 0, count = 0;
      for (int r = std::max(row - kReachPx, 0);
           r <= std::min(row + kReachPx, phases.height_px() - 1); ++r)
        for (int c = std::max(col - kReachPx, 0);
             c <= std::min(col + kReachPx, phases.width_px() - 1); ++c)
          if (std::isfinite(phases.at(r, c))) {
            sum += phases.at(r, c);
            count += 1;
          }
      filled.at(row, col) = count > 0 ? sum / count : 0;
    }
  });
  return filled;
}

MaterialResult MaterialEstimate::run() {
  const std::optional<StripeSet> placed = placed_stripes(in_.signals.patterns, in_.correspondence);
  const PatternRate* white = fully_lit();
  if (!placed) {
    result_.notes.push_back(
        "no stripes with enough shifts along a decoded axis: sigma_a, sigma_s_prime, translucency "
        "and indirect were not computed");
    reflectance_only(white);
    return std::move(result_);
  }
  lit_.emplace(in_, in_.surface, placed->axis);
  const bool is_lut = in_.options.method == "lut";
  const StripeSet stripes = is_lut ? *placed : each_seen(*placed);
  const StripeSignals signals = signals_of(stripes, in_.signals.patterns);
  const StripeScene scene{.camera = camera(),
                          .stripes = stripes,
                          .signals = signals.views,
                          .geometry = geometry(),
                          .transfer = in_.transfer,
                          .model = in_.model};
  if (is_lut)
    fit_by_table(scene);
  else
    fit_by_likelihood(scene);
  result_.profiles = profiles_of(scene);
  return std::move(result_);
}

void MaterialEstimate::reflectance_only(const PatternRate* white) {
  if (white == nullptr) {
    result_.notes.push_back("no white pattern either: diffuse_reflectance was not computed");
    return;
  }
  result_.notes.push_back(
      "diffuse_reflectance is from the white pattern and contains indirect light");
  lit_.emplace(in_, in_.surface, in_.correspondence.column_px.empty() ? Axis::kRow : Axis::kColumn);
  for (int band = 0; band < bands(); ++band)
    store_band(band, reflectance_of_band(camera(), radiometry_of(in_, band), white->rate.view(),
                                         geometry()));
}

void MaterialEstimate::fit_by_table(const StripeScene& scene) {
  result_.notes.push_back(
      "method lut states no uncertainty of its maps: maps/uncertainty.exr holds that of "
      "correspondence and position alone; --method likelihood states all");
  const ProfileTable wide(in_.model, scene.stripes.shape, TableRange{});
  for (int band = 0; band < bands(); ++band)
    store_band(band, fit_band(camera(), radiometry_of(in_, band), scene.stripes, scene.signals,
                              geometry(), in_.transfer, in_.model, wide));
}

void MaterialEstimate::fit_by_likelihood(const StripeScene& scene) {
  const EstimatorOptions& options = in_.options;
  const IndirectLight indirect =
      options.indirect == "zero" ? IndirectLight::kZero : IndirectLight::kFree;
  std::vector<BandRadiometry> radiometry;
  for (int band = 0; band < bands(); ++band) radiometry.push_back(radiometry_of(in_, band));
  const auto likelihoods = [&](const SweepCorrection& correction) {
    std::vector<BandLikelihood> made;
    made.reserve(radiometry.size());
    for (const BandRadiometry& band : radiometry)
      made.emplace_back(scene, band, options.harmonic_count, indirect, correction);
    return made;
  };
  std::vector<BandLikelihood> likelihood = likelihoods({});
  const SweepCorrection correction = sweep_correction(scene, likelihood);
  blur_px2_ = correction.blur_px2;
  if (blur_px2_ != 0 || !correction.offset_px.empty()) likelihood = likelihoods(correction);
  std::size_t valid_count = 0, fixed_count = 0;
  std::vector<MisfitSummary> misfits;
  std::vector<double> untold_frac;
  for (const BandLikelihood& fitter : likelihood) {
    const int band = fitter.radiometry().band;
    SiteFits fits = fitter.fit(valid_sites(camera(), band, geometry().validity), correction);
    add_common_noise(scene, fitter.radiometry(), fits);
    judge_vague_fits(camera(), fits);
    untold_frac.push_back(untold_frac_of(fits));
    if (options.indirect == "auto") fixed_count += fix_indirect_where_earned(camera(), fits);
    BandFit maps =
        maps_of(scene, fitter.radiometry(), fits, {.is_noise_measured = in_.is_noise_measured});
    misfits.push_back(misfit_of(fits, maps));
    valid_count += misfits.back().valid_count;
    store_band(band, std::move(maps));
  }
  note_untold(scene.stripes.shape, untold_frac);
  note_choices(valid_count, fixed_count);
  note_misfit(misfits);
  if (!geometry().directions.empty() && directionality_of(in_.model).has_shift) {
    result_.phase_px = without_gaps(own_phases());
    result_.phase_axis = lit_->axis();
  }
}

// Each pixel's phase in the band that its correspondence was decoded in; the bands' mean where that
// was their sum.
Image<float> MaterialEstimate::own_phases() const {
  Image<float> phases(camera().height_px, camera().width_px);
  const bool is_sum = camera().pixel_format.filter == ColorFilter::kRgb;
  tbb::parallel_for(0, camera().height_px, [&](int row) {
    for (int col = 0; col < camera().width_px; ++col) {
      float sum = 0, count = 0;
      for (int band = 0; band < bands(); ++band) {
        if (!is_sum && band_at(camera(), row, col) != band) continue;
        const float phase = phase_px_[static_cast<std::size_t>(band)].at(row, col);
        if (!std::isfinite(phase)) continue;
        sum += phase;
        count += 1;
      }
      phases.at(row, col) = sum / count;  // NaN where there is none
    }
  });
  return phases;
}

SweepCorrection MaterialEstimate::sweep_correction(const StripeScene& scene,
                                                   std::span<const BandLikelihood> bands) {
  if (in_.options.sweep_errors == "off") return {};
  const std::vector<double> order = capture_order(in_.manifest, scene.stripes, in_.signals);
  const std::optional<SweepErrors> errors = estimate_sweep_errors(scene, bands, order);
  if (!errors) return {};
  const bool is_asked = in_.options.sweep_errors == "correct";
  const EarnedCorrection earned =
      is_asked ? significant_errors(*errors) : earned_correction(*errors);
  // Without a measured noise chi-square does not tell a right correction from a wrong one.
  const bool is_corrected =
      earned.any() && (is_asked || (in_.options.sweep_errors == "auto" && in_.is_noise_measured));
  result_.notes.push_back(describe(*errors, earned, is_corrected));
  return is_corrected ? correction_of(*errors, earned, order) : SweepCorrection{};
}

void MaterialEstimate::note_choices(std::size_t valid_count, std::size_t fixed_count) {
  if (in_.options.indirect == "zero")
    result_.notes.push_back("indirect light was taken as zero everywhere, as asked");
  if (in_.options.indirect == "auto" && valid_count > 0)
    result_.notes.push_back(
        "indirect light was fixed at zero in " +
        fixed(100.0 * static_cast<double>(fixed_count) / static_cast<double>(valid_count), 1) +
        "% of the fits, where the neighbourhood shows none; it was fitted in the others");
  if (!in_.is_noise_measured)
    result_.notes.push_back(
        "the session has no camera.gain_e_per_dn and read_noise_e: noise was estimated from the "
        "data, and the uncertainties with it");
}

void MaterialEstimate::note_untold(StripeShape shape, const std::vector<double>& untold_frac) {
  std::string where;
  for (std::size_t band = 0; band < untold_frac.size(); ++band)
    if (untold_frac[band] > kManyUntold)
      where.append(" ")
          .append(fixed(100 * untold_frac[band], 0))
          .append("% of the fits in ")
          .append(band_name(static_cast<int>(band), bands()))
          .append(",");
  if (where.empty()) return;
  result_.notes.push_back("stripes of period " + std::to_string(shape.period_px) +
                          " px do not tell reflectance, translucency and indirect light apart in" +
                          where +
                          " which hold nothing (validity 128): the period is too short or too long "
                          "for this material, or shifts or light are too few");
}

void MaterialEstimate::note_misfit(const std::vector<MisfitSummary>& bands_misfit) {
  for (std::size_t band = 0; band < bands_misfit.size(); ++band) {
    const MisfitSummary& misfit = bands_misfit[band];
    if (misfit.median_reduced_chi_square < kSuspectChiSquare || !in_.is_noise_measured) continue;
    result_.notes.push_back(
        "band " + band_name(static_cast<int>(band), bands()) +
        ": the data do not look like the model " + in_.model.name() +
        ": the median reduced chi-square is " + fixed(misfit.median_reduced_chi_square, 1) +
        " where noise alone gives 1; the model, its anisotropy, or the calibration is not this "
        "subject's");
  }
}

void MaterialEstimate::store_band(int band, BandFit fit) {
  const auto b = static_cast<std::size_t>(band);
  maps_.validity[b] = std::move(fit.validity);
  maps_.diffuse_reflectance[b] = std::move(fit.diffuse_reflectance);
  if (fit.translucency_px.empty()) return;
  maps_.indirect[b] = std::move(fit.indirect);
  maps_.translucency_mm[b] = std::move(fit.translucency_px);
  maps_.diffuse_reflectance_rel_sd[b] = std::move(fit.diffuse_reflectance_rel_sd);
  maps_.translucency_rel_sd[b] = std::move(fit.translucency_rel_sd);
  maps_.sigma_a_rel_sd[b] = std::move(fit.sigma_a_rel_sd);
  maps_.sigma_s_prime_rel_sd[b] = std::move(fit.sigma_s_prime_rel_sd);
  maps_.indirect_sd[b] = std::move(fit.indirect_sd);
  phase_px_[b] = std::move(fit.phase_px);
  const Image<float> blank(camera().height_px, camera().width_px, 1, kNan);
  maps_.sigma_a_per_mm[b] = blank;
  maps_.sigma_s_prime_per_mm[b] = blank;
  const std::optional<CoefficientCurve> curve = curve_over(in_.model, maps_.diffuse_reflectance[b]);
  tbb::parallel_for(0, camera().height_px, [&](int row) {
    for (int col = 0; col < camera().width_px; ++col) {
      float& translucency = maps_.translucency_mm[b].at(row, col);
      translucency *= pitch_mm().at(row, col);
      if (!std::isfinite(translucency)) continue;
      const Coefficients medium =
          curve->coefficients(static_cast<double>(maps_.diffuse_reflectance[b].at(row, col)),
                              static_cast<double>(translucency));
      maps_.sigma_a_per_mm[b].at(row, col) = static_cast<float>(medium.sigma_a_per_mm);
      maps_.sigma_s_prime_per_mm[b].at(row, col) = static_cast<float>(medium.sigma_s_prime_per_mm);
    }
  });
}

std::vector<ProfilePoint> MaterialEstimate::profiles_of(const StripeScene& scene) const {
  std::vector<ProfilePoint> points = choose_profile_points(camera(), maps_.validity);
  for (ProfilePoint& point : points) {
    point.period_px = scene.stripes.shape.period_px;
    for (int band = 0; band < bands(); ++band) {
      const auto b = static_cast<std::size_t>(band);
      ProfileBand& profile = point.bands[b];
      const auto at_site = [&profile](const Image<float>& map) {
        return map.empty() ? 0 : static_cast<double>(map.at(profile.row, profile.col));
      };
      const double translucency_mm = at_site(maps_.translucency_mm[b]);
      const SiteMaterial found{.row = profile.row,
                               .col = profile.col,
                               .diffuse_reflectance = at_site(maps_.diffuse_reflectance[b]),
                               .translucency_px = translucency_mm / at_site(pitch_mm()),
                               .indirect = at_site(maps_.indirect[b]),
                               .phase_px = at_site(phase_px_[b])};
      profile = profile_of_site(scene, radiometry_of(in_, band), found, blur_px2_);
      profile.translucency_mm = translucency_mm;
    }
  }
  return points;
}

}  // namespace

MaterialResult estimate_material(const MaterialInput& input, Maps& maps) {
  return MaterialEstimate(input, maps).run();
}

}  // namespace estimation
