// What a normal's noise does to the maps: the light and the pitch are told wrong, and the stated
// standard deviations hold it.
#include "estimation/profile/tilt_noise.h"

#include <gtest/gtest.h>

#include <cmath>

#include "estimation/profile/likelihood_maps.h"
#include "tests/estimation/profile/noisy_sweep.h"

namespace estimation {
namespace {

using testing::kCheekGreen;
using testing::kCheekRed;
using testing::kStubbleBlue;
using testing::NoisySweep;
using testing::Skin;
using testing::SweepOptions;

struct Pulls {
  double reflectance = 0, translucency = 0, sigma_a = 0, sigma_s_prime = 0;  // rms
};

Pulls pulls_of(const SweepOptions& options) {
  const NoisySweep sweep(options);
  const StripeScene scene = sweep.scene();
  const BandRadiometry radiometry = sweep.radiometry();
  const BandLikelihood likelihood(scene, radiometry, 0, IndirectLight::kFree, {});
  const SiteFits fits = likelihood.fit(valid_sites(scene.camera, 0, scene.geometry.validity), {});
  const BandFit maps = maps_of(scene, radiometry, fits, {});
  const double reflectance = dipole_reflectance(options.skin.medium, NoisySweep::kEta);
  const double l_d_mm = diffuse_mean_free_path_mm(options.skin.medium);
  Pulls sum;
  double count = 0;
  for (const Site& site : fits.sites) {
    const auto at = [&](const Image<float>& map) {
      return static_cast<double>(map.at(site.row, site.col));
    };
    if ((maps.validity.at(site.row, site.col) & kValidityErrors) != 0) continue;
    // The surface that is told too bright is told to hold shorter pixels.
    const double pitch_mm = NoisySweep::kPitchMm * (1 - at(sweep.tilt_along));
    const Coefficients found =
        scene.model.coefficients(at(maps.diffuse_reflectance), at(maps.translucency_px) * pitch_mm);
    const auto add = [](double& to, double value, double truth, double rel_sd) {
      to += std::pow((value / truth - 1) / rel_sd, 2);
    };
    add(sum.reflectance, at(maps.diffuse_reflectance), reflectance,
        at(maps.diffuse_reflectance_rel_sd));
    add(sum.translucency, at(maps.translucency_px) * pitch_mm, l_d_mm,
        at(maps.translucency_rel_sd));
    add(sum.sigma_a, found.sigma_a_per_mm, options.skin.medium.sigma_a_per_mm,
        at(maps.sigma_a_rel_sd));
    add(sum.sigma_s_prime, found.sigma_s_prime_per_mm, options.skin.medium.sigma_s_prime_per_mm,
        at(maps.sigma_s_prime_rel_sd));
    count += 1;
  }
  const auto rms = [&](double squares) { return std::sqrt(squares / count); };
  EXPECT_GT(count, 0.99 * static_cast<double>(fits.sites.size()));
  return {rms(sum.reflectance), rms(sum.translucency), rms(sum.sigma_a), rms(sum.sigma_s_prime)};
}

TEST(TiltNoise, StatedUncertaintyHoldsIt) {
  for (const Skin& skin : {kCheekRed, kCheekGreen, kStubbleBlue})
    for (const auto& [along, across] : {std::pair(0.02, 0.0), std::pair(0.0, 0.02)}) {
      SCOPED_TRACE(std::string(skin.name) + (along > 0 ? ", along" : ", across"));
      const Pulls pulls = pulls_of({.skin = skin, .tilt_along = along, .tilt_across = across});
      // 3000 pixels: a sixtieth of sampling; the rest is the slope at one k_1 l_d.
      EXPECT_NEAR(pulls.reflectance, 1, 0.05);
      EXPECT_NEAR(pulls.translucency, 1, 0.1);
      EXPECT_NEAR(pulls.sigma_a, 1, 0.1);
      EXPECT_NEAR(pulls.sigma_s_prime, 1, 0.1);
    }
}

}  // namespace
}  // namespace estimation
