// Frames to maps on synthetic planes of known material, without noise.
#include "estimation/estimator.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>
#include <random>

#include "estimation/models/scattering_model.h"
#include "tests/estimation/profile/synthetic_session.h"

namespace estimation {
namespace {

using testing::make_scene;
using testing::Scene;
using testing::SceneOptions;

class Folder {
 public:
  Folder() {
    char name[] = "/tmp/ssrig_estimator_XXXXXX";
    path_ = mkdtemp(name);
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

struct Estimate {
  Maps maps;
  std::vector<std::string> notes;
  std::vector<ProfilePoint> profiles;
};

// The scenes' truth is the dipole.
EstimatorOptions with_dipole(const std::string& method = "likelihood") {
  EstimatorOptions options;
  options.model = "dipole";
  options.method = method;
  return options;
}

Estimate estimate(const Scene& scene, const EstimatorOptions& options = with_dipole(),
                  const std::filesystem::path& session = {}, bool is_shuffled = false) {
  auto estimator = Estimator::create(scene.manifest, session, options);
  EXPECT_TRUE(estimator) << estimator.error().text();
  if (!estimator) return {};
  std::vector<std::size_t> order(scene.frames.size());
  std::iota(order.begin(), order.end(), 0);
  std::mt19937_64 random(7);
  for (std::size_t i = order.size(); is_shuffled && i > 1; --i)
    std::swap(order[i - 1], order[random() % i]);
  for (const std::size_t i : order) {
    const auto added = (*estimator)->add_frame(i, scene.frames[i].view());
    EXPECT_TRUE(added) << added.error().text();
  }
  auto maps = (*estimator)->finish();
  EXPECT_TRUE(maps) << maps.error().text();
  if (!maps) return {};
  return {std::move(*maps), (*estimator)->notes(), (*estimator)->profiles()};
}

// 95th percentile of |map / truth - 1| away from the border, where the surface is smoothed
// one-sided.
double error_frac(const Image<float>& map, double truth) {
  constexpr int kBorderPx = 5;
  std::vector<double> errors;
  for (int row = kBorderPx; row < map.height_px() - kBorderPx; ++row)
    for (int col = kBorderPx; col < map.width_px() - kBorderPx; ++col) {
      const double error = std::abs(static_cast<double>(map.at(row, col)) / truth - 1);
      errors.push_back(std::isnan(error) ? 1e9 : error);
    }
  std::sort(errors.begin(), errors.end());
  return errors[errors.size() * 95 / 100];
}

void expect_recovered(const Scene& scene, const Maps& maps, double tolerance_frac = 0.01) {
  for (std::size_t band = 0; band < static_cast<std::size_t>(maps.band_count); ++band) {
    SCOPED_TRACE(::testing::Message() << "band " << band);
    ASSERT_FALSE(maps.translucency_mm[band].empty());
    EXPECT_LT(error_frac(maps.translucency_mm[band], scene.l_d_mm[band]), tolerance_frac);
    EXPECT_LT(error_frac(maps.diffuse_reflectance[band], scene.reflectance[band]), tolerance_frac);
    EXPECT_LT(error_frac(maps.sigma_a_per_mm[band], scene.medium[band].sigma_a_per_mm),
              2 * tolerance_frac);
    EXPECT_LT(error_frac(maps.sigma_s_prime_per_mm[band], scene.medium[band].sigma_s_prime_per_mm),
              2 * tolerance_frac);
  }
}

void for_each_image(const Maps& maps,
                    const std::function<void(std::span<const std::byte>)>& visit) {
  const auto all = [&](const auto& images) {
    for (const auto& image : images) visit(std::as_bytes(image.samples()));
  };
  for (const BandMaps* bands :
       {&maps.sigma_a_per_mm, &maps.sigma_s_prime_per_mm, &maps.translucency_mm,
        &maps.diffuse_reflectance, &maps.indirect, &maps.sigma_a_rel_sd, &maps.sigma_s_prime_rel_sd,
        &maps.translucency_rel_sd, &maps.diffuse_reflectance_rel_sd, &maps.indirect_sd})
    all(*bands);
  all(maps.position_mm);
  all(maps.normal);
  all(maps.correspondence_px);
  all(maps.correspondence_sd_px);
  all(maps.validity);
  visit(std::as_bytes(maps.position_sd_mm.samples()));
}

std::vector<std::byte> bytes_of(const Maps& maps) {
  std::vector<std::byte> bytes;
  for_each_image(maps, [&](std::span<const std::byte> image) {
    bytes.insert(bytes.end(), image.begin(), image.end());
  });
  return bytes;
}

bool any_contains(const std::vector<std::string>& notes, const std::string& word) {
  return std::any_of(notes.begin(), notes.end(),
                     [&](const std::string& note) { return note.find(word) != std::string::npos; });
}

TEST(Estimator, RecoversMonoWithoutIndirectLight) {
  const Scene scene = make_scene({});
  for (const std::string method : {"likelihood", "lut"}) {
    SCOPED_TRACE(method);
    const Estimate found = estimate(scene, with_dipole(method));
    expect_recovered(scene, found.maps);
    EXPECT_EQ(found.maps.band_count, 1);
    EXPECT_TRUE(found.maps.translucency_mm[1].empty());
    EXPECT_EQ(found.maps.method, method);
    EXPECT_EQ(found.maps.scattering_model, "dipole");
    EXPECT_EQ(found.maps.translucency_rel_sd[0].empty(), method == "lut");
  }
  const std::vector<std::string> notes = estimate(scene, with_dipole("lut")).notes;
  EXPECT_EQ(notes.size(), 1U);  // nothing is missing
  EXPECT_TRUE(any_contains(notes, "states no uncertainty"));
}

TEST(Estimator, RecoversEachBayerOrderAndRgb) {
  for (const ColorFilter filter :
       {ColorFilter::kBayerRG, ColorFilter::kBayerGR, ColorFilter::kBayerGB, ColorFilter::kBayerBG,
        ColorFilter::kRgb}) {
    SCOPED_TRACE(to_string(PixelFormat{filter, 16}));
    SceneOptions options;
    options.format = {filter, 16};
    options.width_px = 32;
    options.height_px = 24;
    const Scene scene = make_scene(options);
    expect_recovered(scene, estimate(scene).maps);
  }
}

TEST(Estimator, RegionOfInterestShiftsTheBayerPhase) {
  SceneOptions options;
  options.format = {ColorFilter::kBayerRG, 16};
  options.width_px = 32;
  options.height_px = 24;
  Scene scene = make_scene(options);
  const Scene other = make_scene([&] {
    SceneOptions shifted = options;
    shifted.format.filter = ColorFilter::kBayerBG;
    return shifted;
  }());
  // BayerBG frames are what a BayerRG sensor gives from an odd corner on; the lens moves along.
  scene.frames = other.frames;
  scene.manifest.camera.roi_x_px = 1;
  scene.manifest.camera.roi_y_px = 1;
  scene.manifest.calibration.camera.K(0, 2) += 1;
  scene.manifest.calibration.camera.K(1, 2) += 1;
  expect_recovered(scene, estimate(scene).maps);
}

TEST(Estimator, StripesMayRunAlongRows) {
  SceneOptions options;
  options.stripe_axis = Axis::kRow;
  const Scene scene = make_scene(options);
  expect_recovered(scene, estimate(scene).maps);
}

TEST(Estimator, BracketsExtendTheRange) {
  SceneOptions options;
  options.exposures_us = {10000, 40000, 200000, 10000};  // the longest clips; one repeats
  const Scene scene = make_scene(options);
  expect_recovered(scene, estimate(scene).maps);
}

TEST(Estimator, BlackPatternTakesOffAmbientAndProjectorBlackOnce) {
  SceneOptions options;
  options.has_black = true;
  options.ambient_dn_per_us = 0.05;
  options.projector_black_frac = 0.01;
  const Scene scene = make_scene(options);
  expect_recovered(scene, estimate(scene).maps);
}

TEST(Estimator, ProjectorBlackIsTakenOffWithoutABlackPattern) {
  SceneOptions options;
  options.projector_black_frac = 0.01;
  const Scene scene = make_scene(options);
  expect_recovered(scene, estimate(scene).maps);
  // The test can fail: unaware of it, the estimate is off.
  Scene unaware = scene;
  unaware.manifest.calibration.projector_black_dn_per_us.clear();
  EXPECT_GT(
      error_frac(estimate(unaware, with_dipole("lut")).maps.translucency_mm[0], scene.l_d_mm[0]),
      0.02);
}

TEST(Estimator, OpticsTransferInEveryForm) {
  SceneOptions options;
  options.blur_harmonic = 8;
  Scene scene = make_scene(options);
  Folder folder;
  TransferByBand curve;
  std::vector<Image<float>> maps;
  std::vector<ExrChannel> channels;
  for (int n = 1; n <= 24; ++n) {
    curve.harmonics[0].push_back(std::exp(-std::pow(n / 8.0, 2)));
    maps.emplace_back(options.height_px, options.width_px, 1,
                      static_cast<float>(curve.harmonics[0].back()));
  }
  for (std::size_t n = 0; n < maps.size(); ++n)
    channels.push_back({"R." + std::to_string(n + 1), maps[n].view()});
  ASSERT_TRUE(write_exr(folder.path() / "transfer.exr", channels, {}));
  TransferByDepth by_depth;
  by_depth.entries = {{500, curve}, {2000, curve}};
  for (const StripeTransfer& form : {StripeTransfer(curve), StripeTransfer(by_depth),
                                     StripeTransfer(TransferFile{"transfer.exr"})}) {
    SCOPED_TRACE(form.index());
    scene.manifest.calibration.stripe_transfer = form;
    expect_recovered(scene, estimate(scene, with_dipole(), folder.path()).maps);
  }
}

TEST(Estimator, FlatFieldVignettingAndDarkFramesAreReadFromTheSession) {
  SceneOptions options;
  Scene scene = make_scene(options);
  Folder folder;
  Image<float> flat(options.height_px, options.width_px);
  for (int row = 0; row < options.height_px; ++row)
    for (int col = 0; col < options.width_px; ++col) {
      flat.at(row, col) = 1.0F - 0.01F * static_cast<float>(col % 7);
      for (Image<std::uint16_t>& frame : scene.frames) {
        // Rounded to even DN by the flat field's division; a few 1e-5 of the signal.
        const double signal = frame.at(row, col) - 200.0;
        frame.at(row, col) = static_cast<std::uint16_t>(
            std::lround(200 + 0.5 * signal * static_cast<double>(flat.at(row, col))));
      }
    }
  const Image<float> vignetting(256, 256, 1, 0.5F);
  ASSERT_TRUE(write_exr(folder.path() / "flat.exr", {{"Y", flat.view()}}, {}));
  ASSERT_TRUE(write_exr(folder.path() / "vignetting.exr", {{"Y", vignetting.view()}}, {}));
  scene.manifest.camera.flat_field_file = "flat.exr";
  scene.manifest.calibration.irradiance->vignetting_file = "vignetting.exr";
  expect_recovered(scene, estimate(scene, with_dipole(), folder.path()).maps);

  const std::array<float, 4> no_response{0, -1, std::numeric_limits<float>::quiet_NaN(),
                                         std::numeric_limits<float>::infinity()};
  for (int i = 0; i < 4; ++i) flat.at(16, 10 + 5 * i) = no_response[static_cast<std::size_t>(i)];
  ASSERT_TRUE(write_exr(folder.path() / "flat.exr", {{"Y", flat.view()}}, {}));
  const Estimate damaged = estimate(scene, with_dipole(), folder.path());
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(damaged.maps.validity[0].at(16, 10 + 5 * i) & kValidityErrors, kSaturated) << i;
    EXPECT_EQ(damaged.maps.validity[0].at(16, 11 + 5 * i) & kValidityErrors, 0U) << i;
  }
  EXPECT_TRUE(any_contains(damaged.notes, "flat_field is not above 0 at 4 pixels"));

  scene.manifest.camera.flat_field_file = "vignetting.exr";  // wrong size
  const auto wrong = Estimator::create(scene.manifest, folder.path(), {});
  ASSERT_FALSE(wrong);
  EXPECT_NE(wrong.error().text().find("/camera/flat_field"), std::string::npos);
}

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

TEST(Estimator, NoiseIsEstimatedFromTheDataIfTheCameraDoesNotSay) {
  Scene scene = make_scene({});
  scene.manifest.camera.gain_e_per_dn.reset();
  scene.manifest.camera.read_noise_e.reset();
  const Estimate found = estimate(scene);
  expect_recovered(scene, found.maps);
  EXPECT_FALSE(found.maps.is_noise_measured);
}

TEST(Estimator, OrderOfArrivalAndThreadsDoNotChangeABit) {
  SceneOptions options;
  options.format = {ColorFilter::kBayerRG, 12};
  options.gain_dn_per_us = 0.2;
  options.exposures_us = {10000, 40000, 10000};
  options.indirect = 0.02;
  const Scene scene = make_scene(options);
  EstimatorOptions one_thread = with_dipole(), four_threads = with_dipole();
  one_thread.thread_count = 1;
  four_threads.thread_count = 4;
  const Estimate expected = estimate(scene, one_thread);
  EXPECT_FALSE(expected.profiles.empty());
  for (const bool is_shuffled : {false, true}) {
    SCOPED_TRACE(is_shuffled);
    const Estimate found = estimate(scene, four_threads, {}, is_shuffled);
    EXPECT_EQ(bytes_of(found.maps), bytes_of(expected.maps));
    EXPECT_EQ(found.profiles, expected.profiles);
  }
}

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
