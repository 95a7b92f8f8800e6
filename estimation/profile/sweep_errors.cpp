#include "estimation/profile/sweep_errors.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <iomanip>
#include <limits>
#include <numbers>
#include <sstream>

#include "estimation/profile/site_factors.h"
#include "estimation/profile/small_matrix.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr std::size_t kFewestSites = 200;
constexpr std::size_t kParts = 16;
constexpr int kRounds = 5;
// A step as small as this share of its standard deviation is the last one.
constexpr double kLastStep = 0.1;
// Beyond it the exponential of a negative variance says nothing.
constexpr double kLeastBlurPx2 = -1, kGreatestStepPx2 = 2;
// Sites that fit so much worse than their band's median show something else.
constexpr double kOutlier = 4;
constexpr double kSignificantSd = 5;
// What a calibration leaves: half of the correction that design/estimation.md calls mandatory.
constexpr double kToleratedBlurPx = 0.2, kToleratedDriftPx = 0.05;
// Of the reduced chi-square over one, where a correction was the right one. Burley's model on the
// dipole's light looks like 1.15 px of blur, which takes it from 23 to 1.08; true blur leaves 0.99.
constexpr double kRemainingExcess = 0.05;

using std::numbers::pi;

// Of one site or many: information about (blur variance, drift) with the sites' own unknowns
// projected out, and the gradient.
struct Shared {
  double blur_blur = 0, blur_drift = 0, drift_drift = 0, blur = 0, drift = 0;

  void add(const Shared& other, double sign = 1) {
    blur_blur += sign * other.blur_blur;
    blur_drift += sign * other.blur_drift;
    drift_drift += sign * other.drift_drift;
    blur += sign * other.blur;
    drift += sign * other.drift;
  }
  double determinant() const { return blur_blur * drift_drift - blur_drift * blur_drift; }
  std::array<double, 2> solution() const {
    const double det = determinant();
    return {(drift_drift * blur - blur_drift * drift) / det,
            (blur_blur * drift - blur_drift * blur) / det};
  }
};

// One site's samples and derivatives at its fit. One per task.
class SiteResiduals {
 public:
  SiteResiduals(const StripeScene& scene, const BandLikelihood& band,
                const SweepCorrection& correction, std::span<const double> capture_order)
      : scene_(scene),
        band_(band),
        correction_(correction),
        order_(capture_order),
        count_(static_cast<std::size_t>(band.harmonic_count())),
        factors_(scene, band.radiometry().band, band.harmonic_count(), correction.blur_px2) {}

  Shared at(const SiteFits& fits, std::size_t i) {
    load(fits, i);
    const std::size_t unknowns = band_.indirect() == IndirectLight::kFree ? 4 : 3;
    SmallMatrix<4> normal{};
    std::array<double, 4> of_blur{}, of_drift{}, of_residual{};
    Shared raw;
    for (std::size_t j = 0; j < scene_.signals.size(); ++j) {
      const Sample sample = sample_at(fits, i, j);
      if (!std::isfinite(sample.residual)) continue;
      const double w = sample.weight;
      for (std::size_t a = 0; a < unknowns; ++a) {
        for (std::size_t b = 0; b < unknowns; ++b)
          normal[a][b] += w * sample.own[a] * sample.own[b];
        of_blur[a] += w * sample.own[a] * sample.blur;
        of_drift[a] += w * sample.own[a] * sample.drift;
        of_residual[a] += w * sample.own[a] * sample.residual;
      }
      raw.add({.blur_blur = w * sample.blur * sample.blur,
               .blur_drift = w * sample.blur * sample.drift,
               .drift_drift = w * sample.drift * sample.drift,
               .blur = w * sample.blur * sample.residual,
               .drift = w * sample.drift * sample.residual});
    }
    if (unknowns == 3) normal[3][3] = 1;
    const auto root = scaled_cholesky(normal);
    if (!root) return {};
    const auto by_blur = root->solve(of_blur), by_drift = root->solve(of_drift);
    const auto dot = [](const std::array<double, 4>& a, const std::array<double, 4>& b) {
      return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    };
    raw.add({.blur_blur = dot(of_blur, by_blur),
             .blur_drift = dot(of_blur, by_drift),
             .drift_drift = dot(of_drift, by_drift),
             .blur = dot(of_residual, by_blur),
             .drift = dot(of_residual, by_drift)},
            -1);
    return raw;
  }

 private:
  struct Sample {
    double residual = 0, weight = 0, blur = 0, drift = 0;
    std::array<double, 4> own{};  // by phase, t, ln l_d, B
  };

  void load(const SiteFits& fits, std::size_t i) {
    material_ = {static_cast<double>(fits.fit.logit_reflectance[i]),
                 static_cast<double>(fits.fit.log_translucency_px[i])};
    const auto values = factors_.at(fits.sites[i], material_);
    factor_.assign(values.begin(), values.end());
    constexpr double kStep = 1e-3;
    const double logit = material_.logit_reflectance, log = material_.log_translucency_px;
    harmonics(logit, log, value_);
    const auto slope = [&](double by_logit, double by_log, std::vector<double>& out) {
      harmonics(logit + by_logit, log + by_log, out);
      harmonics(logit - by_logit, log - by_log, lower_);
      for (std::size_t n = 0; n < count_; ++n) out[n] = (out[n] - lower_[n]) / (2 * kStep);
    };
    slope(kStep, 0, by_logit_);
    slope(0, kStep, by_log_);
  }

  // 2 a_n
  void harmonics(double logit, double log_px, std::vector<double>& out) {
    const StripeShape shape = scene_.stripes.shape;
    k_times_l_d_.resize(count_);
    out.resize(count_);
    for (std::size_t n = 1; n <= count_; ++n)
      k_times_l_d_[n - 1] = 2 * pi * static_cast<double>(n) / shape.period_px * std::exp(log_px);
    scene_.model.transform(1 / (1 + std::exp(-logit)), k_times_l_d_, out);
    for (std::size_t n = 1; n <= count_; ++n)
      out[n - 1] *= 2 * std::sin(pi * static_cast<double>(n) * shape.width_px / shape.period_px) /
                    (pi * static_cast<double>(n));
  }

  Sample sample_at(const SiteFits& fits, std::size_t i, std::size_t j) const {
    const StripeShape shape = scene_.stripes.shape;
    const BandRadiometry& radiometry = band_.radiometry();
    const Site site = fits.sites[i];
    const double full = band_.full_signal_per_us(site);
    const double offset_px =
        correction_.offset_px.empty() ? 0 : static_cast<double>(correction_.offset_px[j]);
    const double x_px = static_cast<double>(scene_.geometry.position_px.at(site.row, site.col)) +
                        static_cast<double>(fits.fit.phase_px[i]) - scene_.stripes.shifts_px[j] -
                        offset_px - 0.5 * (shape.width_px - 1);
    const double duty = static_cast<double>(shape.width_px) / shape.period_px;
    const double level = factor_[0].real() * (duty + radiometry.projector_black_frac);
    const double reflectance = 1 / (1 + std::exp(-material_.logit_reflectance));
    double expected = level * (reflectance + static_cast<double>(fits.fit.indirect[i]));
    Sample sample;
    sample.own[1] = level * reflectance * (1 - reflectance);
    sample.own[3] = level;
    const std::complex<double> first = std::polar(1.0, 2 * pi / shape.period_px * x_px);
    std::complex<double> wheel(1, 0);
    for (std::size_t n = 1; n <= count_; ++n) {
      const double wave = 2 * pi * static_cast<double>(n) / shape.period_px;
      wheel *= first;
      const std::complex<double> turn = factor_[n] * wheel;
      expected += value_[n - 1] * turn.real();
      sample.own[0] -= value_[n - 1] * wave * turn.imag();
      sample.own[1] += by_logit_[n - 1] * turn.real();
      sample.own[2] += by_log_[n - 1] * turn.real();
      sample.blur -= 0.5 * wave * wave * value_[n - 1] * turn.real();
    }
    sample.drift = -order_[j] * sample.own[0];
    const double measured = static_cast<double>(scene_.signals[j].at(
                                site.row, site.col, channel_of(scene_.camera, radiometry.band))) /
                            full;
    sample.residual = measured - expected;
    sample.weight = full * full / variance_at(radiometry.noise, expected * full);
    return sample;
  }

  const StripeScene& scene_;
  const BandLikelihood& band_;
  const SweepCorrection& correction_;
  std::span<const double> order_;
  std::size_t count_;
  SiteFactors factors_;
  ShapePoint material_;
  std::vector<std::complex<double>> factor_;
  std::vector<double> value_, by_logit_, by_log_, lower_, k_times_l_d_;
};

double median_misfit(const BatchFit& fit, const std::vector<std::size_t>& chosen) {
  std::vector<float> misfits;
  for (const std::size_t i : chosen) misfits.push_back(fit.reduced_chi_square[i]);
  if (misfits.empty()) return 1;
  const auto middle = misfits.begin() + static_cast<std::ptrdiff_t>(misfits.size() / 2);
  std::nth_element(misfits.begin(), middle, misfits.end());
  return static_cast<double>(*middle);
}

// Valid, away from discontinuities, and no outliers.
std::vector<std::size_t> usable(const StripeScene& scene, const SiteFits& fits) {
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < fits.sites.size(); ++i)
    if ((fits.fit.validity[i] & kValidityErrors) == 0 &&
        (scene.geometry.validity.at(fits.sites[i].row, fits.sites[i].col) & kNearDiscontinuity) ==
            0)
      chosen.push_back(i);
  const double limit = kOutlier * std::max(median_misfit(fits.fit, chosen), 1.0);
  std::erase_if(chosen, [&](std::size_t i) {
    return !(static_cast<double>(fits.fit.reduced_chi_square[i]) < limit);
  });
  return chosen;
}

// One look at all bands under a correction.
struct Look {
  std::array<Shared, kParts> parts{};  // of the image, from top to bottom
  double chi_square = 1;
  std::size_t site_count = 0;

  Shared total() const {
    Shared sum;
    for (const Shared& part : parts) sum.add(part);
    return sum;
  }
};

Look look(const StripeScene& scene, std::span<const BandLikelihood> bands,
          const SweepCorrection& correction, std::span<const double> capture_order) {
  Look seen;
  double weighted_chi_square = 0;
  for (const BandLikelihood& band : bands) {
    if (band.harmonic_count() == 0) continue;
    const SiteFits fits = band.fit(band.pilot().sites, correction);
    const std::vector<std::size_t> chosen = usable(scene, fits);
    std::vector<Shared> each(chosen.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, chosen.size(), 32),
                      [&](const auto& range) {
                        SiteResiduals residuals(scene, band, correction, capture_order);
                        for (std::size_t i = range.begin(); i != range.end(); ++i)
                          each[i] = residuals.at(fits, chosen[i]);
                      });
    for (std::size_t i = 0; i < each.size(); ++i) seen.parts[i * kParts / each.size()].add(each[i]);
    weighted_chi_square += median_misfit(fits.fit, chosen) * static_cast<double>(chosen.size());
    seen.site_count += chosen.size();
  }
  if (seen.site_count > 0)
    seen.chi_square = weighted_chi_square / static_cast<double>(seen.site_count);
  return seen;
}

// By leaving out one part after the other; at least what noise alone makes.
std::array<double, 2> standard_deviations(const Look& seen) {
  const Shared total = seen.total();
  const double noise = std::max(seen.chi_square, 1.0) / total.determinant();
  std::array<double, 2> mean{}, square{};
  for (const Shared& part : seen.parts) {
    Shared others = total;
    others.add(part, -1);
    const std::array<double, 2> without = others.solution();
    for (std::size_t k = 0; k < 2; ++k) {
      mean[k] += without[k] / kParts;
      square[k] += without[k] * without[k] / kParts;
    }
  }
  const auto jackknife = [&](std::size_t k) {
    return (kParts - 1) * std::max(square[k] - mean[k] * mean[k], 0.0);
  };
  return {std::sqrt(std::max(noise * total.drift_drift, jackknife(0))),
          std::sqrt(std::max(noise * total.blur_blur, jackknife(1)))};
}

SweepCorrection both(double blur_px2, double drift_px, std::span<const double> capture_order) {
  SweepCorrection correction{.blur_px2 = blur_px2};
  for (const double order : capture_order)
    correction.offset_px.push_back(static_cast<float>(drift_px * order));
  return correction;
}

std::string with_sd(double value, double sd) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(3) << value << " +- " << sd;
  return text.str();
}

}  // namespace

std::optional<SweepErrors> estimate_sweep_errors(const StripeScene& scene,
                                                 std::span<const BandLikelihood> bands,
                                                 std::span<const double> capture_order) {
  SweepErrors errors{.has_perfect_optics = scene.transfer.is_perfect()};
  for (int round = 0; round < kRounds; ++round) {
    const Look seen =
        look(scene, bands, both(errors.blur_px2, errors.drift_px, capture_order), capture_order);
    const Shared total = seen.total();
    if (seen.site_count < kFewestSites || !(total.determinant() > 0)) return std::nullopt;
    const auto [blur_sd, drift_sd] = standard_deviations(seen);
    if (round == 0) errors.chi_square_before = seen.chi_square;
    errors.chi_square_after = seen.chi_square;
    errors.blur_px2_sd = blur_sd;
    errors.drift_sd_px = drift_sd;
    errors.site_count = seen.site_count;
    const auto [blur_step, drift_step] = total.solution();
    if (!std::isfinite(blur_step) || !std::isfinite(drift_step)) return std::nullopt;
    if (std::abs(blur_step) < kLastStep * blur_sd && std::abs(drift_step) < kLastStep * drift_sd)
      break;
    errors.blur_px2 =
        std::max(errors.blur_px2 + std::clamp(blur_step, -kGreatestStepPx2, kGreatestStepPx2),
                 kLeastBlurPx2);
    errors.drift_px += std::clamp(drift_step, -kGreatestStepPx2, kGreatestStepPx2);
  }
  return errors;
}

EarnedCorrection significant_errors(const SweepErrors& errors) {
  const bool is_possible = errors.blur_px2 > 0 || !errors.has_perfect_optics;
  const double blur = std::abs(errors.blur_px2), drift = std::abs(errors.drift_px);
  return {.has_blur = is_possible && blur > kSignificantSd * errors.blur_px2_sd &&
                      blur > kToleratedBlurPx * kToleratedBlurPx,
          .has_drift = drift > kSignificantSd * errors.drift_sd_px && drift > kToleratedDriftPx};
}

EarnedCorrection earned_correction(const SweepErrors& errors) {
  return errors.chi_square_after - 1 < kRemainingExcess ? significant_errors(errors)
                                                        : EarnedCorrection{};
}

SweepCorrection correction_of(const SweepErrors& errors, EarnedCorrection earned,
                              std::span<const double> capture_order) {
  return both(earned.has_blur ? errors.blur_px2 : 0, earned.has_drift ? errors.drift_px : 0,
              earned.has_drift ? capture_order : std::span<const double>());
}

std::string describe(const SweepErrors& errors, EarnedCorrection earned, bool is_corrected) {
  std::ostringstream text;
  const double blur_px = std::sqrt(std::abs(errors.blur_px2));
  const bool is_blur_seen =
      std::abs(errors.blur_px2) > kSignificantSd * errors.blur_px2_sd && blur_px > kToleratedBlurPx;
  const bool is_drift_seen = std::abs(errors.drift_px) > kSignificantSd * errors.drift_sd_px &&
                             std::abs(errors.drift_px) > kToleratedDriftPx;
  text << "residual blur ";
  if (is_blur_seen)
    text << with_sd(blur_px, errors.blur_px2_sd / (2 * blur_px)) << " px "
         << (errors.blur_px2 > 0 ? "more" : "less") << " than the calibration says";
  else
    text << "as the calibration says (variance " << with_sd(errors.blur_px2, errors.blur_px2_sd)
         << " px^2)";
  text << "; drift over the sweep " << with_sd(errors.drift_px, errors.drift_sd_px)
       << (is_drift_seen ? " px" : " px, none to speak of");
  if (!is_blur_seen && !is_drift_seen) return text.str();
  text << std::fixed << std::setprecision(2) << "; with both the reduced chi-square is "
       << errors.chi_square_after << " instead of " << errors.chi_square_before << ": ";
  if (is_corrected)
    text << "corrected";
  else
    text << (earned.any() ? "not corrected"
                          : "not corrected, the misfit is not theirs: a wrong model shows as "
                            "blur, too");
  return text.str();
}

}  // namespace estimation
