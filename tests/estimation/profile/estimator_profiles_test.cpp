// The profiles of the estimator's four points, and the curves matched to them, on synthetic planes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <vector>

#include "estimation/estimator.h"
#include "estimation/models/scattering_model.h"
#include "tests/estimation/profile/estimated_scene.h"

namespace estimation {
namespace {

using testing::error_frac;
using testing::estimate;
using testing::Estimate;
using testing::make_scene;
using testing::Scene;
using testing::SceneOptions;
using testing::with_dipole;

// The shift about which the samples are symmetric: the phase of their first harmonic.
double measured_peak_px(const ProfileBand& band, double period_px) {
  double re = 0, im = 0;
  for (const ProfileSample& sample : band.measured) {
    const double angle_rad = 2 * std::numbers::pi * sample.shift_px / period_px;
    re += sample.reflectance * std::cos(angle_rad);
    im += sample.reflectance * std::sin(angle_rad);
  }
  return std::atan2(im, re) * period_px / (2 * std::numbers::pi);
}

// Samples less curve, relative to the curve's peak.
struct Misfit {
  double greatest = 0, mean = 0;
};

Misfit misfit_frac(const ProfileBand& band) {
  Misfit misfit;
  double peak = 0;
  for (const ProfileSample& curve : band.matched) {
    peak = std::max(peak, curve.reflectance);
    for (const ProfileSample& sample : band.measured) {
      if (sample.shift_px != curve.shift_px) continue;
      const double difference = sample.reflectance - curve.reflectance;
      misfit.greatest = std::max(misfit.greatest, std::abs(difference));
      misfit.mean += difference / static_cast<double>(band.measured.size());
    }
  }
  return {misfit.greatest / peak, misfit.mean / peak};
}

// Four points, each band at its own site with its own peak, its curve through its samples.
void expect_profiles(const Scene& scene, const std::vector<ProfilePoint>& profiles) {
  const CameraInfo& camera = scene.manifest.camera;
  const bool is_mosaic = camera.pixel_format.filter != ColorFilter::kMono &&
                         sample_channel_count(camera.pixel_format.filter) == 1;
  ASSERT_EQ(profiles.size(), 4U);
  for (const ProfilePoint& point : profiles) {
    EXPECT_EQ(point.period_px, 40);
    for (int band = 0; band < band_count(camera.pixel_format.filter); ++band) {
      SCOPED_TRACE(::testing::Message()
                   << "row " << point.row << ", column " << point.col << ", band " << band);
      const auto b = static_cast<std::size_t>(band);
      const ProfileBand& profile = point.bands[b];
      EXPECT_LE(std::abs(profile.row - point.row), is_mosaic ? 1 : 0);
      EXPECT_LE(std::abs(profile.col - point.col), is_mosaic ? 1 : 0);
      if (is_mosaic) {
        EXPECT_EQ(band_at(camera, profile.row, profile.col), band);
      }
      EXPECT_EQ(profile.measured.size(), 40U);
      const double true_peak_px =
          static_cast<double>(scene.u_px.at(profile.row, profile.col)) - 3.5;
      EXPECT_LT(std::abs(std::remainder(profile.peak_px - true_peak_px, 40)), 0.1);
      EXPECT_LT(std::abs(std::remainder(profile.peak_px - measured_peak_px(profile, 40), 40)), 0.1);
      EXPECT_LT(misfit_frac(profile).greatest, 0.001);
      EXPECT_NEAR(profile.diffuse_reflectance, scene.reflectance[b], 0.01 * scene.reflectance[b]);
      EXPECT_NEAR(profile.translucency_mm, scene.l_d_mm[b], 0.01 * scene.l_d_mm[b]);
    }
  }
}

TEST(Estimator, ProfilesOfEachMosaicAreCentredAndMatched) {
  for (const ColorFilter filter :
       {ColorFilter::kMono, ColorFilter::kRgb, ColorFilter::kBayerRG, ColorFilter::kBayerGR,
        ColorFilter::kBayerGB, ColorFilter::kBayerBG}) {
    SCOPED_TRACE(to_string(PixelFormat{filter, 16}));
    SceneOptions options;
    options.format = {filter, 16};
    const Scene scene = make_scene(options);
    expect_profiles(scene, estimate(scene).profiles);
  }
}

TEST(Estimator, MatchedCurveHoldsProjectorBlackAndOptics) {
  SceneOptions options;
  options.projector_black_frac = 0.01;
  options.blur_harmonic = 8;
  Scene scene = make_scene(options);
  TransferByBand curve;
  for (int n = 1; n <= 24; ++n) curve.harmonics[0].push_back(std::exp(-std::pow(n / 8.0, 2)));
  scene.manifest.calibration.stripe_transfer = curve;
  const Estimate found = estimate(scene);
  ASSERT_EQ(found.profiles.size(), 4U);
  for (const ProfilePoint& point : found.profiles) {
    EXPECT_LT(misfit_frac(point.bands[0]).greatest, 0.001);
    EXPECT_TRUE(point.bands[1].measured.empty());
  }
}

TEST(Estimator, MatchedCurveHoldsIndirectLight) {
  SceneOptions options;
  options.indirect = 0.03;
  const Scene scene = make_scene(options);
  for (const ProfilePoint& point : estimate(scene).profiles)
    EXPECT_LT(misfit_frac(point.bands[0]).greatest, 0.001);
  const Estimate found = estimate(scene, with_dipole("lut"));
  ASSERT_EQ(found.profiles.size(), 4U);
  for (const ProfilePoint& point : found.profiles) {
    // The paper's method finds 40% of this much, so the curve is a little off; but what it finds is
    // 0.8% of the peak, and R_d is measured after it: the means agree.
    EXPECT_LT(misfit_frac(point.bands[0]).greatest, 0.01);
    EXPECT_NEAR(misfit_frac(point.bands[0]).mean, 0, 0.0005);
  }
}

TEST(Estimator, ProfilesOfNoisyFramesMatchWithinTheNoise) {
  SceneOptions options;
  options.format = {ColorFilter::kBayerRG, 12};
  options.gain_dn_per_us = 0.15;
  Scene scene = make_scene(options);
  scene.manifest.camera.gain_e_per_dn = 5;
  std::mt19937_64 random(3);
  for (Image<std::uint16_t>& frame : scene.frames)
    for (std::uint16_t& dn : frame.samples()) {
      // Nearly Gaussian of one sd: twelve uniform draws.
      double normal = -6;
      for (int i = 0; i < 12; ++i)
        normal += static_cast<double>(random()) / static_cast<double>(random.max());
      const double variance_dn2 = std::max(dn - 200, 0) / 5.0 + 10.0 * 10.0 / 25.0;
      dn = static_cast<std::uint16_t>(
          std::clamp(std::lround(dn + normal * std::sqrt(variance_dn2)), 0L, 4095L));
    }
  const std::vector<ProfilePoint> profiles = estimate(scene).profiles;
  ASSERT_EQ(profiles.size(), 4U);
  for (const ProfilePoint& point : profiles)
    for (std::size_t b = 0; b < 3; ++b) {
      const ProfileBand& band = point.bands[b];
      SCOPED_TRACE(::testing::Message()
                   << "row " << point.row << ", column " << point.col << ", band " << b);
      EXPECT_LT(std::abs(std::remainder(band.peak_px - measured_peak_px(band, 40), 40)), 0.5);
      // DN of a reflectance factor of one; chi^2 of 40 samples about a curve of three numbers.
      const double full_dn = scene.manifest.calibration.irradiance->signal_per_us[b] * 20000 *
                             static_cast<double>(scene.gain.at(band.row, band.col));
      double chi2 = 0;
      for (const ProfileSample& sample : band.measured)
        for (const ProfileSample& curve : band.matched)
          if (curve.shift_px == sample.shift_px)
            chi2 += std::pow((sample.reflectance - curve.reflectance) * full_dn, 2) /
                    (std::max(curve.reflectance, 0.0) * full_dn / 5 + 4);
      EXPECT_GT(chi2, 15);  // 0.05% of chi^2 with 37 degrees of freedom lie below
      EXPECT_LT(chi2, 75);  // and 0.02% above
    }
}

TEST(Estimator, StripesAlongRowsPeakAtTheirRow) {
  SceneOptions options;
  options.stripe_axis = Axis::kRow;
  const std::vector<ProfilePoint> profiles = estimate(make_scene(options)).profiles;
  ASSERT_EQ(profiles.size(), 4U);
  for (const ProfilePoint& point : profiles) {
    const ProfileBand& band = point.bands[0];
    EXPECT_LT(std::abs(std::remainder(band.peak_px - measured_peak_px(band, 40), 40)), 0.1);
    EXPECT_LT(misfit_frac(band).greatest, 0.001);
  }
}

double median_abs_difference(const Image<float>& found, const Image<float>& truth) {
  std::vector<double> errors;
  for (std::size_t i = 0; i < found.samples().size(); ++i)
    errors.push_back(std::abs(static_cast<double>(found.samples()[i] - truth.samples()[i])));
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  return errors[errors.size() / 2];
}

// The truth is the model's own here, for what the estimator makes of it: the correspondence.
TEST(Estimator, ObliqueLightMovesTheCorrespondenceBack) {
  const auto angular = make_scattering_model("monte_carlo_angular", {});
  ASSERT_TRUE(angular);
  SceneOptions options;
  options.model = angular->get();
  const Scene scene = make_scene(options);
  const double apparent_px =
      median_abs_difference(estimate(scene).maps.correspondence_px[0], scene.u_px);
  EstimatorOptions with_angles;
  with_angles.model = "monte_carlo_angular";
  const Estimate found = estimate(scene, with_angles);
  const double corrected_px = median_abs_difference(found.maps.correspondence_px[0], scene.u_px);
  std::printf("column off by %.3f px, corrected by %.3f\n", apparent_px, corrected_px);
  EXPECT_GT(apparent_px, 0.1);
  EXPECT_LT(corrected_px, 0.02);
  EXPECT_LT(error_frac(found.maps.translucency_mm[0], scene.l_d_mm[0]), 0.02);
  EXPECT_LT(error_frac(found.maps.diffuse_reflectance[0], scene.reflectance[0]), 0.02);
  for (const ProfilePoint& point : found.profiles)
    EXPECT_LT(misfit_frac(point.bands[0]).greatest, 0.005);
}

}  // namespace
}  // namespace estimation
