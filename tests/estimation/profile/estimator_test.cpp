// Frames to maps on synthetic planes of known material, without noise.
#include "estimation/estimator.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "tests/estimation/profile/estimated_scene.h"
#include "tests/temporary_folder.h"

namespace estimation {
namespace {

using test_support::TemporaryFolder;
using testing::any_contains;
using testing::error_frac;
using testing::estimate;
using testing::Estimate;
using testing::expect_recovered;
using testing::make_scene;
using testing::Scene;
using testing::SceneOptions;
using testing::with_dipole;

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
  TemporaryFolder folder;
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
  TemporaryFolder folder;
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

}  // namespace
}  // namespace estimation
