#include "estimation/geometry/triangulation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

using testing::make_rig;
using testing::opencv_pixel;
using testing::projector_pixel;
using testing::SyntheticRig;

// Points over the field of view, 900 to 1100 mm away.
std::vector<Vec3> draw_points(int count) {
  std::mt19937_64 engine(7);
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(engine() >> 11) * 0x1.0p-53;
  };
  std::vector<Vec3> points;
  for (int i = 0; i < count; ++i) {
    const double z = uniform(900, 1100);
    points.push_back({uniform(-0.15, 0.15) * z, uniform(-0.11, 0.11) * z, z});
  }
  return points;
}

TEST(LensModel, AgreesWithOpenCvAndInvertsItself) {
  const SyntheticRig rig = make_rig(588, 432, true);
  for (const Lens& lens : {rig.calibration.camera, rig.calibration.projector}) {
    const LensModel model(lens);
    for (const Vec3& point : draw_points(200)) {
      const Vec2 normalized(point[0] / point[2], point[1] / point[2]);
      const Vec2 pixel = model.image(normalized).pixel;
      EXPECT_LT(cv::norm(pixel - opencv_pixel(lens, point)), 1e-9);
      const auto back = model.unimage(pixel);
      ASSERT_TRUE(back);
      EXPECT_LT(cv::norm(back->normalized - normalized), 1e-12);
    }
  }
}

TEST(LensModel, DerivativesMatchFiniteDifferences) {
  const LensModel model(make_rig(588, 432, true).calibration.projector);
  constexpr double kStep = 1e-6;
  for (const Vec3& point : draw_points(50)) {
    const Vec2 at(point[0] / point[2], point[1] / point[2]);
    const LensModel::Imaged imaged = model.image(at);
    for (int axis = 0; axis < 2; ++axis) {
      Vec2 step(0, 0);
      step[axis] = kStep;
      const Vec2 slope =
          (model.image(at + step).pixel - model.image(at - step).pixel) / (2 * kStep);
      EXPECT_NEAR(slope[0], imaged.pixel_by_normalized(0, axis), 1e-4);
      EXPECT_NEAR(slope[1], imaged.pixel_by_normalized(1, axis), 1e-4);
    }
    const auto back = model.unimage(imaged.pixel);
    ASSERT_TRUE(back);
    EXPECT_LT(cv::norm(back->normalized_by_pixel * imaged.pixel_by_normalized - Mat2::eye()), 1e-9);
  }
}

TEST(LensModel, APixelBeyondTheFoldHasNoRay) {
  Lens lens;
  lens.K = Mat3(100, 0, 0, 0, 100, 0, 0, 0, 1);
  lens.distortion = {-0.5, 0, 0, 0, 0};
  EXPECT_TRUE(LensModel(lens).unimage(Vec2(20, 10)));
  EXPECT_FALSE(LensModel(lens).unimage(Vec2(300, 100)));
}

TEST(Triangulation, FindsPointsToAMillionthOfAMillimetre) {
  for (const bool with_distortion : {false, true}) {
    SyntheticRig rig = make_rig(588, 432, with_distortion);
    rig.camera.roi_x_px = 37;
    rig.camera.roi_y_px = -5;
    const Stereo stereo(rig.calibration, rig.camera);
    for (const Vec3& point : draw_points(300)) {
      const Vec2 seen = opencv_pixel(rig.calibration.camera, point) - Vec2(37, -5);
      const Vec2 lit = projector_pixel(rig, point);
      const auto ray = stereo.ray(seen[1], seen[0]);
      ASSERT_TRUE(ray);
      ProjectorReading column, row, both;
      column.column_px = both.column_px = lit[0];
      row.row_px = both.row_px = lit[1];
      column.column_sd_px = both.column_sd_px = 0.02;
      row.row_sd_px = both.row_sd_px = 0.2;
      for (const ProjectorReading& reading : {column, both}) {
        const auto depth = stereo.triangulate(*ray, reading);
        ASSERT_TRUE(depth);
        EXPECT_LT(cv::norm(ray->direction * depth->depth_mm - point), 1e-6);
        EXPECT_LT(depth->epipolar_px, 1e-6);
      }
    }
  }
}

TEST(Triangulation, StandardDeviationIsWhatAColumnErrorMoves) {
  const SyntheticRig rig = make_rig(588, 432, true);
  const Stereo stereo(rig.calibration, rig.camera);
  const auto ray = stereo.ray(200, 300);
  ASSERT_TRUE(ray);
  const Vec2 lit = projector_pixel(rig, ray->direction * 1000.0);
  ProjectorReading reading;
  reading.column_px = lit[0];
  reading.column_sd_px = 0.02;
  const auto there = stereo.triangulate(*ray, reading);
  reading.column_px += 0.02;
  const auto moved = stereo.triangulate(*ray, reading);
  ASSERT_TRUE(there && moved);
  EXPECT_NEAR(std::abs(moved->depth_mm - there->depth_mm), there->sd_mm, 1e-4 * there->sd_mm);
  // 0.3 mm a column, 14 degrees between the rays.
  EXPECT_NEAR(there->sd_mm, 0.024, 0.004);
}

TEST(Triangulation, DisagreementOfTheAxesIsTheEpipolarDistance) {
  const SyntheticRig rig = make_rig(588, 432, false);
  const Stereo stereo(rig.calibration, rig.camera);
  const auto ray = stereo.ray(200, 300);
  ASSERT_TRUE(ray);
  const Vec2 near = projector_pixel(rig, ray->direction * 990.0);
  const Vec2 far = projector_pixel(rig, ray->direction * 1010.0);
  const Vec2 along = (far - near) / cv::norm(far - near);
  const Vec2 lit = projector_pixel(rig, ray->direction * 1000.0) + 5.0 * Vec2(-along[1], along[0]);
  const auto depth = stereo.triangulate(*ray, {lit[0], 0.1, lit[1], 0.1});
  ASSERT_TRUE(depth);
  EXPECT_NEAR(depth->epipolar_px, 5, 0.01);
}

TEST(Triangulation, NothingBehindTheDevices) {
  const SyntheticRig rig = make_rig(588, 432, false);
  const Stereo stereo(rig.calibration, rig.camera);
  const auto ray = stereo.ray(200, 300);
  ASSERT_TRUE(ray);
  // A column so far off that its plane meets the ray behind the camera.
  ProjectorReading reading;
  reading.column_px = projector_pixel(rig, ray->direction * 1e7)[0] + 400;
  reading.column_sd_px = 0.1;
  const auto beyond = stereo.triangulate(*ray, reading);
  reading.column_px -= 800;
  const auto before = stereo.triangulate(*ray, reading);
  EXPECT_NE(beyond.has_value(), before.has_value());
}

}  // namespace
}  // namespace estimation
