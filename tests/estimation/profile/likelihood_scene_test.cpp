// Whole images through the likelihood: errors as stated, indirect light where it was earned, blur
// and drift from the data of all pixels.
#include "estimation/profile/likelihood_scene.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "estimation/models/burley.h"
#include "estimation/profile/indirect_choice.h"
#include "estimation/profile/likelihood_maps.h"
#include "estimation/profile/sweep_errors.h"
#include "tests/estimation/profile/noisy_sweep.h"

namespace estimation {
namespace {

using testing::kCheekGreen;
using testing::kCheekRed;
using testing::kStubbleBlue;
using testing::NoisySweep;
using testing::Skin;
using testing::SweepOptions;

SiteFits fit_all(const NoisySweep& sweep, const SweepCorrection& correction = {},
                 IndirectLight indirect = IndirectLight::kFree) {
  const StripeScene scene = sweep.scene();
  const BandRadiometry radiometry = sweep.radiometry();
  const BandLikelihood likelihood(scene, radiometry, 0, indirect, correction);
  return likelihood.fit(valid_sites(scene.camera, 0, scene.geometry.validity), correction);
}

struct Moments {
  double mean = 0, rms = 0;
};

// Of (value - truth) / scale over all sites; every one must be valid.
template <typename Value>
Moments moments(const SiteFits& fits, const Value& value) {
  Moments found;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    EXPECT_EQ(fits.fit.validity[i] & kValidityErrors, 0U);
    const double v = value(i);
    found.mean += v;
    found.rms += v * v;
  }
  const double count = static_cast<double>(fits.sites.size());
  return {found.mean / count, std::sqrt(found.rms / count)};
}

double sd_of(const BatchFit& fit, std::size_t i, std::size_t k) {
  return std::sqrt(static_cast<double>(fit.covariance[covariance_index(k, k) * fit.stride + i]));
}

struct Truth {
  double logit = 0, log_px = 0;
};

Truth truth_of(const Skin& skin) {
  const double reflectance = dipole_reflectance(skin.medium, NoisySweep::kEta);
  return {std::log(reflectance / (1 - reflectance)),
          std::log(diffuse_mean_free_path_mm(skin.medium) / NoisySweep::kPitchMm)};
}

Moments log_error(const SiteFits& fits, const Skin& skin) {
  const double truth = truth_of(skin).log_px;
  return moments(fits, [&](std::size_t i) {
    return static_cast<double>(fits.fit.log_translucency_px[i]) - truth;
  });
}

Moments sigma_a_error(const SiteFits& fits, const Skin& skin) {
  const Dipole model(NoisySweep::kEta);
  return moments(fits, [&](std::size_t i) {
    const double reflectance =
        1 / (1 + std::exp(-static_cast<double>(fits.fit.logit_reflectance[i])));
    const double l_d_mm =
        NoisySweep::kPitchMm * std::exp(static_cast<double>(fits.fit.log_translucency_px[i]));
    return std::log(model.coefficients(reflectance, l_d_mm).sigma_a_per_mm /
                    skin.medium.sigma_a_per_mm);
  });
}

// Pulls of t, ln l_d, B and the projector coordinate.
std::array<Moments, 4> pulls(const NoisySweep& sweep, const SiteFits& fits, const Skin& skin,
                             double indirect) {
  const Truth truth = truth_of(skin);
  const BatchFit& fit = fits.fit;
  const StripeScene scene = sweep.scene();
  const auto pull = [&](std::size_t k, const std::vector<float>& values, double expected) {
    return moments(fits, [&, k, expected](std::size_t i) {
      return (static_cast<double>(values[i]) - expected) / sd_of(fit, i, k);
    });
  };
  const Moments phase = moments(fits, [&](std::size_t i) {
    const auto [row, col] = fits.sites[i];
    return static_cast<double>(scene.geometry.position_px.at(row, col) + fit.phase_px[i] -
                               sweep.true_u_px.at(row, col)) /
           sd_of(fit, i, 3);
  });
  return {pull(0, fit.logit_reflectance, truth.logit),
          pull(1, fit.log_translucency_px, truth.log_px), pull(2, fit.indirect, indirect), phase};
}

TEST(LikelihoodScene, PullsHaveUnitVariance) {
  for (const Skin& skin : {kCheekRed, kCheekGreen, kStubbleBlue})
    for (const double indirect : {0.0, 0.1}) {
      SCOPED_TRACE(::testing::Message() << skin.name << ", B " << indirect);
      const NoisySweep sweep({.skin = skin, .indirect = indirect});
      const SiteFits fits = fit_all(sweep);
      for (const Moments& pull : pulls(sweep, fits, skin, indirect)) {
        EXPECT_NEAR(pull.rms, 1, 0.05);  // 3000 pixels: +-0.013
        EXPECT_NEAR(pull.mean, 0, 0.1);  // a tenth of the standard deviation
      }
    }
}

TEST(LikelihoodScene, IndirectLightIsFixedOnlyWhereThereIsNone) {
  const Skin skin = kCheekRed;
  const NoisySweep none({.skin = skin}), some({.skin = skin, .indirect = 0.02});
  SiteFits fits = fit_all(none);
  const double free_rms = log_error(fits, skin).rms;
  const std::size_t fixed = fix_indirect_where_earned(none.scene().camera, fits);
  std::printf("B = 0: %zu of %zu fixed, rms of ln l_d %.4f instead of %.4f\n", fixed,
              fits.sites.size(), log_error(fits, skin).rms, free_rms);
  EXPECT_GT(fixed, fits.sites.size() * 3 / 4);
  EXPECT_LT(log_error(fits, skin).rms, 0.6 * free_rms);
  for (const std::size_t k : {std::size_t{0}, std::size_t{1}}) {
    const Moments pull = pulls(none, fits, skin, 0)[k];
    EXPECT_NEAR(pull.rms, 1, 0.1);
  }
  // In closed form as by a fit without B.
  const SiteFits zero = fit_all(none, {}, IndirectLight::kZero);
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if ((fits.fit.validity[i] & kIndirectFixedAtZero) == 0) continue;
    EXPECT_EQ(fits.fit.indirect[i], 0);
    EXPECT_NEAR(fits.fit.log_translucency_px[i], zero.fit.log_translucency_px[i],
                0.5 * sd_of(zero.fit, i, 1));
  }
  SiteFits lit = fit_all(some);
  EXPECT_EQ(fix_indirect_where_earned(some.scene().camera, lit), 0U);
}

struct Corrected {
  SweepErrors errors;
  EarnedCorrection earned;
  SweepCorrection correction;
};

Corrected look_for_errors(const NoisySweep& sweep, const ScatteringModel* model = nullptr) {
  const StripeScene scene = model != nullptr ? sweep.scene(*model) : sweep.scene();
  const BandRadiometry radiometry = sweep.radiometry();
  std::vector<BandLikelihood> bands;
  bands.emplace_back(scene, radiometry, 0, IndirectLight::kFree);
  const auto errors = estimate_sweep_errors(scene, bands, sweep.order);
  EXPECT_TRUE(errors);
  if (!errors) return {};
  const EarnedCorrection earned = earned_correction(*errors);
  std::printf("%s\n", describe(*errors, earned, earned.any()).c_str());
  return {*errors, earned, correction_of(*errors, earned, sweep.order)};
}

TEST(SweepErrors, BlurOfAPixelLeavesOnePercentOnceCorrected) {
  for (const Skin& skin : {kCheekRed, kCheekGreen, kStubbleBlue}) {
    SCOPED_TRACE(skin.name);
    const NoisySweep sweep({.skin = skin, .indirect = 0.02, .blur_px = 1});
    const Corrected found = look_for_errors(sweep);
    EXPECT_TRUE(found.earned.has_blur);
    EXPECT_FALSE(found.earned.has_drift);
    EXPECT_NEAR(found.errors.blur_px2, 1, 4 * found.errors.blur_px2_sd);
    const SiteFits before = fit_all(sweep), after = fit_all(sweep, found.correction);
    std::printf("%s: l_d %+.2f%% -> %+.2f%%, sigma_a %+.2f%% -> %+.2f%%\n", skin.name,
                100 * log_error(before, skin).mean, 100 * log_error(after, skin).mean,
                100 * sigma_a_error(before, skin).mean, 100 * sigma_a_error(after, skin).mean);
    EXPECT_GT(log_error(before, skin).mean, 0.08);
    EXPECT_LT(std::abs(log_error(after, skin).mean), 0.01);
    EXPECT_LT(std::abs(sigma_a_error(after, skin).mean), 0.02);
  }
}

TEST(SweepErrors, DriftOfHalfAPixelLeavesOnePercentOnceCorrected) {
  for (const Skin& skin : {kCheekRed, kCheekGreen, kStubbleBlue}) {
    SCOPED_TRACE(skin.name);
    const NoisySweep sweep({.skin = skin, .indirect = 0.02, .drift_px = 0.5});
    const Corrected found = look_for_errors(sweep);
    EXPECT_TRUE(found.earned.has_drift);
    EXPECT_FALSE(found.earned.has_blur);
    EXPECT_NEAR(found.errors.drift_px, 0.5, 4 * found.errors.drift_sd_px);
    const SiteFits before = fit_all(sweep), after = fit_all(sweep, found.correction);
    std::printf("%s: l_d %+.2f%% -> %+.2f%%, sigma_a %+.2f%% -> %+.2f%%\n", skin.name,
                100 * log_error(before, skin).mean, 100 * log_error(after, skin).mean,
                100 * sigma_a_error(before, skin).mean, 100 * sigma_a_error(after, skin).mean);
    std::printf("rms of ln l_d %.4f -> %.4f\n", log_error(before, skin).rms,
                log_error(after, skin).rms);
    // Up or down by where a pixel lies between the stripes.
    EXPECT_GT(log_error(before, skin).rms, 1.5 * log_error(after, skin).rms);
    EXPECT_LT(std::abs(log_error(after, skin).mean), 0.01);
    EXPECT_LT(std::abs(sigma_a_error(after, skin).mean), 0.02);
  }
}

TEST(SweepErrors, ASoundSweepAgreesWithItsCalibration) {
  const NoisySweep sweep({.skin = kCheekGreen, .indirect = 0.02});
  const Corrected found = look_for_errors(sweep);
  EXPECT_FALSE(found.earned.any());
  EXPECT_LT(std::abs(found.errors.blur_px2), 4 * found.errors.blur_px2_sd);
  EXPECT_LT(std::abs(found.errors.drift_px), 4 * found.errors.drift_sd_px);
  EXPECT_NE(describe(found.errors, found.earned, false).find("as the calibration says"),
            std::string::npos);
}

TEST(SweepErrors, AWrongModelIsNotTakenForBlur) {
  const NoisySweep sweep({.skin = kCheekGreen, .indirect = 0.02});
  const Burley burley(NoisySweep::kEta);
  const Corrected found = look_for_errors(sweep, &burley);
  EXPECT_FALSE(found.earned.any());
  EXPECT_TRUE(significant_errors(found.errors).has_blur);
}

TEST(LikelihoodScene, BackgroundIsNoSiteAndThreadsDoNotChangeABit) {
  const NoisySweep sweep({.filter = ColorFilter::kBayerRG, .is_background_half = true});
  const StripeScene scene = sweep.scene();
  const BandRadiometry radiometry = sweep.radiometry(1);
  std::vector<SiteFits> found;
  for (const int threads : {1, 2, 3, 4})
    oneapi::tbb::task_arena(threads).execute([&] {
      std::vector<BandLikelihood> bands;
      bands.emplace_back(scene, radiometry, 0, IndirectLight::kFree);
      const auto errors = estimate_sweep_errors(scene, bands, sweep.order);
      ASSERT_TRUE(errors);
      found.push_back(bands.front().fit(
          valid_sites(scene.camera, 1, scene.geometry.validity),

          correction_of(*errors, {.has_blur = true, .has_drift = true}, sweep.order)));
      fix_indirect_where_earned(scene.camera, found.back());
    });
  EXPECT_EQ(found[0].sites.size(), 30U * 50 / 2);
  for (const Site& site : found[0].sites) EXPECT_GE(site.col, 30);
  const auto same = [](const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
  };
  for (const SiteFits& other : found) {
    EXPECT_TRUE(same(other.fit.log_translucency_px, found[0].fit.log_translucency_px));
    EXPECT_TRUE(same(other.fit.indirect, found[0].fit.indirect));
    EXPECT_TRUE(same(other.fit.covariance, found[0].fit.covariance));
    EXPECT_EQ(other.fit.validity, found[0].fit.validity);
  }
}

TEST(LikelihoodMaps, MisfitIsFlaggedAndSummed) {
  const NoisySweep sweep({.skin = kCheekGreen});
  const BandRadiometry radiometry = sweep.radiometry();
  for (const bool is_right : {true, false}) {
    const Burley burley(NoisySweep::kEta);
    const StripeScene scene = is_right ? sweep.scene() : sweep.scene(burley);
    const BandLikelihood likelihood(scene, radiometry, 0, IndirectLight::kFree);
    const SiteFits fits = likelihood.fit(valid_sites(scene.camera, 0, scene.geometry.validity), {});
    const MisfitSummary misfit = misfit_of(fits, maps_of(scene, radiometry, fits, {}));
    std::printf("median reduced chi-square %.2f, %zu of %zu poor\n",
                misfit.median_reduced_chi_square, misfit.poor_count, misfit.valid_count);
    if (is_right) {
      EXPECT_NEAR(misfit.median_reduced_chi_square, 0.98, 0.03);
      EXPECT_EQ(misfit.poor_count, 0U);
    } else {
      EXPECT_GT(misfit.median_reduced_chi_square, 2);
      EXPECT_GT(misfit.poor_count, misfit.valid_count / 2);
    }
  }
}

}  // namespace
}  // namespace estimation
