// A sphere under stripes that is moved by a known vector: what its surface says of the motion.
#include "estimation/motion/surface_motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <random>

#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

constexpr double kRadiusMm = 90, kDistanceMm = 1000;

CameraInfo mono_camera() {
  CameraInfo camera;
  camera.width_px = 196;
  camera.height_px = 144;
  camera.pixel_format = {ColorFilter::kMono, 12};
  camera.black_level_dn = 64;
  camera.saturation_level_dn = 4000;
  camera.gain_e_per_dn = 5;
  return camera;
}

Calibration stereo() {
  Calibration calibration;
  calibration.camera.K = Mat3(626, 0, 97.5, 0, 626, 71.5, 0, 0, 1);
  calibration.projector.K = Mat3(2000, 0, 1012, 0, 2000, 384, 0, 0, 1);
  calibration.projector_from_camera_mm = {-250, 0, 0};
  return calibration;
}

// Where a pixel's ray meets the sphere that has moved by `by_mm`.
std::optional<Vec3> seen_point(const Stereo& stereo, const Vec3& by_mm, int row, int col) {
  const auto ray = stereo.ray(row, col);
  const Vec3 centre = Vec3(0, 0, kDistanceMm + kRadiusMm) + by_mm;
  const double a = ray->direction.dot(ray->direction), b = ray->direction.dot(centre);
  const double c = centre.dot(centre) - kRadiusMm * kRadiusMm;
  const double discriminant = b * b - a * c;
  if (discriminant < 0.1 * kRadiusMm * kRadiusMm * a) return std::nullopt;  // grazing
  return ray->direction * ((b - std::sqrt(discriminant)) / a);
}

Image<std::uint16_t> photograph(const Vec3& by_mm, std::uint64_t seed) {
  const CameraInfo camera = mono_camera();
  const Stereo stereo_pair(stereo(), camera);
  Image<std::uint16_t> frame(camera.height_px, camera.width_px);
  std::mt19937_64 random(seed);
  for (int row = 0; row < camera.height_px; ++row) {
    for (int col = 0; col < camera.width_px; ++col) {
      double dn = 64;
      if (const auto point = seen_point(stereo_pair, by_mm, row, col)) {
        const double u = stereo_pair.project(*point)->pixel[0];
        dn += 1500 * (0.1 + std::exp(4 * (std::cos(2 * CV_PI * u / 40) - 1)));
      }
      double sum = -6;
      for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11U) * 0x1.0p-53;
      frame.at(row, col) = static_cast<std::uint16_t>(
          std::clamp(std::lround(dn + sum * std::sqrt(std::max(0.0, dn - 64) / 5 + 4)), 0L, 4095L));
    }
  }
  return frame;
}

Maps sphere_maps() {
  const CameraInfo camera = mono_camera();
  const Stereo stereo_pair(stereo(), camera);
  Maps maps;
  maps.height_px = camera.height_px;
  maps.width_px = camera.width_px;
  const float nothing = std::numeric_limits<float>::quiet_NaN();
  const Image<float> empty(camera.height_px, camera.width_px, 1, nothing);
  maps.position_mm = {empty, empty, empty};
  maps.normal = {empty, empty, empty};
  maps.correspondence_px = {empty, empty};
  for (int row = 0; row < camera.height_px; ++row) {
    for (int col = 0; col < camera.width_px; ++col) {
      const auto point = seen_point(stereo_pair, {0, 0, 0}, row, col);
      if (!point) continue;
      const Vec3 normal = (*point - Vec3(0, 0, kDistanceMm + kRadiusMm)) / kRadiusMm;
      const auto lit = stereo_pair.project(*point);
      for (std::size_t i = 0; i < 3; ++i) {
        maps.position_mm[i].at(row, col) = static_cast<float>((*point)[static_cast<int>(i)]);
        maps.normal[i].at(row, col) = static_cast<float>(normal[static_cast<int>(i)]);
      }
      maps.correspondence_px[0].at(row, col) = static_cast<float>(lit->pixel[0]);
      maps.correspondence_px[1].at(row, col) = static_cast<float>(lit->pixel[1]);
    }
  }
  return maps;
}

constexpr double kPeriodPx = 40 * 626.0 / 2000;

TEST(SurfaceMotion, TranslationIsFoundWithinItsUncertainty) {
  const Maps maps = sphere_maps();
  const Image<std::uint16_t> first = photograph({0, 0, 0}, 1);
  std::mt19937_64 random(5);
  double squares = 0;
  constexpr int kDraws = 8;
  for (int draw = 0; draw < kDraws; ++draw) {
    Vec3 moved_mm;
    for (int i = 0; i < 3; ++i)
      moved_mm[i] = -0.8 + 1.6 * static_cast<double>(random() >> 11U) * 0x1.0p-53;
    const Image<std::uint16_t> second =
        photograph(moved_mm, 100U + static_cast<std::uint64_t>(draw));
    const auto motion = measure_surface_motion(mono_camera(), stereo(), Axis::kColumn, kPeriodPx,
                                               maps, first.view(), second.view());
    ASSERT_TRUE(motion) << motion.error().text();
    SCOPED_TRACE(draw);
    std::printf("%d: %.3f %.3f %.3f found %.3f+-%.3f %.3f+-%.3f %.3f+-%.3f\n", draw, moved_mm[0],
                moved_mm[1], moved_mm[2], motion->translation_mm[0], motion->sd_mm[0],
                motion->translation_mm[1], motion->sd_mm[1], motion->translation_mm[2],
                motion->sd_mm[2]);
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(motion->translation_mm[i], moved_mm[i], 0.04);
      EXPECT_LT(motion->sd_mm[i], 0.02);
      squares += std::pow((motion->translation_mm[i] - moved_mm[i]) / motion->sd_mm[i], 2);
    }
  }
  const double rms = std::sqrt(squares / (3 * kDraws));
  std::printf("errors over sd: rms %.2f\n", rms);
  EXPECT_GT(rms, 0.4);
  EXPECT_LT(rms, 2.0);  // 1.4: the slope is that of five cells, not the pattern's own
}

TEST(SurfaceMotion, WithoutASurfaceItIsSaidSo) {
  const Image<std::uint16_t> frame = photograph({0, 0, 0}, 1);
  Maps maps;
  maps.height_px = mono_camera().height_px;
  maps.width_px = mono_camera().width_px;
  const auto motion = measure_surface_motion(mono_camera(), stereo(), Axis::kColumn, kPeriodPx,
                                             maps, frame.view(), frame.view());
  ASSERT_FALSE(motion);
  EXPECT_THAT(motion.error().text(), testing::HasSubstr("there is no surface"));
}

}  // namespace
}  // namespace estimation
