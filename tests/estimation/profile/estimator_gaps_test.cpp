// What the estimator makes of frames that clip or are missing, of patterns, keys and options that
// do not suffice: what it can, and it says so.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <vector>

#include "estimation/estimator.h"
#include "tests/estimation/profile/estimated_scene.h"

namespace estimation {
namespace {

using testing::any_contains;
using testing::error_frac;
using testing::estimate;
using testing::Estimate;
using testing::expect_recovered;
using testing::make_scene;
using testing::Scene;
using testing::SceneOptions;
using testing::with_dipole;

// The stripes' middles clip, or more than half of all samples.
SceneOptions clipping_scene(double gain_dn_per_us) {
  SceneOptions options;
  options.background_cols = 10;
  options.gain_dn_per_us = gain_dn_per_us;
  options.exposures_us = {40000};
  return options;
}

TEST(Estimator, BothMethodsDoWithoutTheSaturatedSamples) {
  const Scene scene = make_scene(clipping_scene(8));
  for (const char* method : {"likelihood", "lut"}) {
    SCOPED_TRACE(method);
    const Maps maps = estimate(scene, with_dipole(method)).maps;
    EXPECT_EQ(maps.validity[0].at(16, 25) & kValidityErrors, 0U);
    EXPECT_NEAR(maps.translucency_mm[0].at(16, 25), scene.l_d_mm[0], 0.02 * scene.l_d_mm[0]);
    EXPECT_NEAR(maps.diffuse_reflectance[0].at(16, 25), scene.reflectance[0], 0.01);
    EXPECT_EQ(maps.validity[0].at(16, 3) & kValidityErrors, kBackground);
  }
}

TEST(Estimator, BackgroundAndSaturationAreNamedAndHoldNothing) {
  const Estimate found = estimate(make_scene(clipping_scene(100)), with_dipole("lut"));
  const Maps& maps = found.maps;
  ASSERT_FALSE(maps.translucency_mm[0].empty());
  EXPECT_EQ(maps.validity[0].at(16, 3) & kValidityErrors, kBackground);
  EXPECT_NE(maps.validity[0].at(16, 25) & kSaturated, 0U);
  for (const Image<float>* map : {&maps.translucency_mm[0], &maps.diffuse_reflectance[0],
                                  &maps.sigma_a_per_mm[0], &maps.sigma_s_prime_per_mm[0]}) {
    EXPECT_TRUE(std::isnan(map->at(16, 3)));
    EXPECT_TRUE(std::isnan(map->at(16, 25)));
  }
}

TEST(Estimator, ValuesAreFiniteExactlyWhereValidityHasNoError) {
  SceneOptions options;
  options.background_cols = 7;
  options.format = {ColorFilter::kBayerGB, 12};
  options.gain_dn_per_us = 0.2;
  const Maps maps = estimate(make_scene(options)).maps;
  for (std::size_t band = 0; band < 3; ++band)
    for (int row = 0; row < options.height_px; ++row)
      for (int col = 0; col < options.width_px; ++col) {
        const bool is_valid = (maps.validity[band].at(row, col) & kValidityErrors) == 0;
        for (const BandMaps* map :
             {&maps.translucency_mm, &maps.diffuse_reflectance, &maps.indirect,
              &maps.sigma_a_per_mm, &maps.sigma_s_prime_per_mm})
          ASSERT_EQ(std::isfinite((*map)[band].at(row, col)), is_valid)
              << "band " << band << " row " << row << " col " << col;
        if (is_valid) {
          EXPECT_GT(maps.sigma_a_per_mm[band].at(row, col), 0);
          EXPECT_GT(maps.sigma_s_prime_per_mm[band].at(row, col), 0);
        }
      }
}

TEST(Estimator, WhiteAloneGivesReflectanceWithItsWarning) {
  SceneOptions options;
  options.has_stripes = false;
  options.has_white = true;
  const Scene scene = make_scene(options);
  const Estimate found = estimate(scene);
  EXPECT_LT(error_frac(found.maps.diffuse_reflectance[0], scene.reflectance[0]), 0.01);
  EXPECT_TRUE(found.maps.translucency_mm[0].empty());
  EXPECT_EQ(found.maps.validity[0].at(16, 20), kIndirectFixedAtZero);
  EXPECT_TRUE(any_contains(found.notes, "translucency"));
  EXPECT_TRUE(found.profiles.empty());
}

TEST(Estimator, CorrespondencePatternsAloneGiveGeometry) {
  SceneOptions options;
  options.has_stripes = false;
  const Estimate found = estimate(make_scene(options));
  EXPECT_FALSE(found.maps.position_mm[2].empty());
  EXPECT_TRUE(found.maps.diffuse_reflectance[0].empty());
  EXPECT_TRUE(any_contains(found.notes, "diffuse_reflectance"));
}

TEST(Estimator, StripesAloneCannotBePlacedAndSaySo) {
  SceneOptions options;
  options.has_correspondence = false;
  const Estimate found = estimate(make_scene(options));
  EXPECT_TRUE(found.maps.translucency_mm[0].empty());
  EXPECT_FALSE(found.notes.empty());
}

TEST(Estimator, WithoutRadiometricKeysGeometryIsEstimatedAndSaid) {
  Scene scene = make_scene({});
  scene.manifest.camera.black_level_dn.reset();
  scene.manifest.calibration.irradiance.reset();
  const Estimate found = estimate(scene);
  EXPECT_FALSE(found.maps.position_mm[0].empty());
  EXPECT_TRUE(found.maps.translucency_mm[0].empty());
  EXPECT_TRUE(any_contains(found.notes, "camera.black_level"));
  EXPECT_TRUE(any_contains(found.notes, "calibration.irradiance.signal_per_us"));
  EstimatorOptions geometry_only;
  geometry_only.is_geometry_only = true;
  const Estimate asked = estimate(make_scene({}), geometry_only);
  EXPECT_TRUE(asked.maps.translucency_mm[0].empty());
  EXPECT_TRUE(asked.notes.empty());
  EXPECT_TRUE(asked.profiles.empty());
}

TEST(Estimator, PatternsWithMissingFramesUseTheOthersAndSaySo) {
  SceneOptions options;
  options.exposures_us = {10000, 20000};
  const Scene scene = make_scene(options);
  auto estimator = Estimator::create(scene.manifest, {}, with_dipole());
  ASSERT_TRUE(estimator);
  for (std::size_t i = 0; i < scene.frames.size(); ++i) {
    if (i == 7 || i == 10 || i == 11) continue;  // a long exposure, and all of shift 5
    ASSERT_TRUE((*estimator)->add_frame(i, scene.frames[i].view()));
  }
  const auto maps = (*estimator)->finish();
  ASSERT_TRUE(maps);
  EXPECT_TRUE(any_contains((*estimator)->notes(), "pattern 3"));
  EXPECT_TRUE(any_contains((*estimator)->notes(), "1 of 80 patterns have no frame"));
  expect_recovered(scene, *maps, 0.03);
}

TEST(Estimator, FramesThatDoNotBelongAreRefused) {
  const Scene scene = make_scene({});
  auto estimator = Estimator::create(scene.manifest, {}, {});
  ASSERT_TRUE(estimator);
  EXPECT_FALSE((*estimator)->add_frame(scene.frames.size(), scene.frames[0].view()));
  const Image<std::uint16_t> small(3, 3);
  EXPECT_FALSE((*estimator)->add_frame(0, small.view()));
  EXPECT_TRUE((*estimator)->add_frame(0, scene.frames[0].view()));
  EXPECT_FALSE((*estimator)->add_frame(0, scene.frames[0].view()));
  auto unfed = Estimator::create(scene.manifest, {}, {});
  ASSERT_TRUE(unfed);
  const auto nothing = (*unfed)->finish();
  ASSERT_FALSE(nothing);
  EXPECT_EQ(nothing.error().fault, InputFault::kInsufficient);
}

TEST(EstimatorOptions, EveryBadFieldIsReported) {
  EstimatorOptions options;
  EXPECT_TRUE(options.validate());
  options.method = "guess";
  options.model = "tripole";
  options.indirect = "perhaps";
  options.sweep_errors = "never";
  options.harmonic_count = 65;
  options.thread_count = -1;
  const auto invalid = options.validate();
  ASSERT_FALSE(invalid);
  for (const char* word : {"guess", "tripole", "perhaps", "never", "65", "-1"})
    EXPECT_NE(invalid.error().text().find(word), std::string::npos) << word;
}

TEST(EstimatorOptions, TheTableSearchHasNoneOfTheLikelihoodsChoices) {
  EstimatorOptions options = with_dipole("lut");
  EXPECT_TRUE(options.validate());
  options.indirect = "zero";
  options.harmonic_count = 6;
  options.sweep_errors = "off";
  const auto invalid = options.validate();
  ASSERT_FALSE(invalid);
  for (const char* word : {"indirect", "harmonic_count", "sweep_errors"})
    EXPECT_NE(invalid.error().text().find(word), std::string::npos) << word;
}

}  // namespace
}  // namespace estimation
