#include "estimation/calibration/geometry_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "estimation/geometry/triangulation.h"
#include "tests/estimation/calibration/synthetic_board.h"

namespace estimation {
namespace {

using testing::BoardPlace;
using ::testing::HasSubstr;
using testing::make_rig;
using testing::see_boards;
using testing::SyntheticBoards;
using testing::SyntheticRig;

constexpr ImageSize kCameraSize{2352, 1726}, kProjectorSize{1024, 768};

SyntheticRig full_rig() { return make_rig(kCameraSize.width_px, kCameraSize.height_px, true); }

Vec3 rotation_error_rad(const Calibration& found, const Calibration& truth) {
  Vec3 error;
  cv::Rodrigues(found.projector_from_camera * truth.projector_from_camera.t(), error);
  return error;
}

Result<GeometryFit> fit(const SyntheticRig&, const std::vector<BoardPose>& poses) {
  return fit_geometry(poses, kCameraSize, kProjectorSize);
}

// Depth of a frontal plane at 1 m as triangulated with the calibration found from what the true rig
// reads: rms from its place, and rms after the best plane is taken away.
struct PlaneError {
  double in_place_mm = 0, flatness_mm = 0;
};

PlaneError plane_error(const SyntheticRig& rig, const Calibration& found, const Vec3& normal) {
  const Stereo truth(rig.calibration, rig.camera), stereo(found, rig.camera);
  const Vec3 through(0, 0, 1000);
  std::vector<Vec3> points;
  double sum = 0;
  for (int row = 50; row < rig.camera.height_px; row += 125)
    for (int col = 50; col < rig.camera.width_px; col += 125) {
      const auto true_ray = truth.ray(row, col);
      const auto ray = stereo.ray(row, col);
      if (!true_ray || !ray) continue;
      const double depth_mm = normal.dot(through) / normal.dot(true_ray->direction);
      const auto lit = truth.project(true_ray->direction * depth_mm);
      if (!lit || lit->pixel[0] < 0 || lit->pixel[0] > 1023 || lit->pixel[1] < 0 ||
          lit->pixel[1] > 767)
        continue;
      const auto depth = stereo.triangulate(*ray, {lit->pixel[0], 0.02, lit->pixel[1], 0.02});
      if (!depth) continue;
      points.push_back(ray->direction * depth->depth_mm);
      const double off_mm = normal.dot(points.back() - through);
      sum += off_mm * off_mm;
    }
  cv::Mat1d design(static_cast<int>(points.size()), 3), z(static_cast<int>(points.size()), 1), x;
  for (int i = 0; i < design.rows; ++i) {
    const Vec3& p = points[static_cast<std::size_t>(i)];
    design(i, 0) = p[0];
    design(i, 1) = p[1];
    design(i, 2) = 1;
    z(i, 0) = p[2];
  }
  cv::solve(design, z, x, cv::DECOMP_SVD);
  const double slope = std::hypot(1.0, std::hypot(x(0), x(1)));
  const double count = static_cast<double>(points.size());
  return {std::sqrt(sum / count), cv::norm(design * x - z) / std::sqrt(count) / slope};
}

TEST(GeometryFit, WithoutNoiseFindsTheRigItself) {
  const SyntheticRig rig = full_rig();
  SyntheticRig plain = rig;
  plain.calibration.camera.distortion[4] = plain.calibration.projector.distortion[4] = 0;
  const auto poses = see_boards(plain, {.shape = {},
                                        .places = testing::fifteen_places(),
                                        .camera_noise_px = 0,
                                        .projector_noise_px = 0});
  const auto found = fit(plain, poses);
  ASSERT_TRUE(found) << found.error().text();
  EXPECT_LT(found->camera_rms_px, 1e-5);
  EXPECT_LT(found->projector_rms_px, 1e-5);
  EXPECT_LT(cv::norm(rotation_error_rad(found->calibration, plain.calibration)), 1e-6);
  EXPECT_LT(cv::norm(found->calibration.projector_from_camera_mm -
                     plain.calibration.projector_from_camera_mm),
            1e-3);
  EXPECT_NEAR(found->calibration.camera.K(0, 0), plain.calibration.camera.K(0, 0), 1e-2);
  EXPECT_NEAR(found->calibration.projector.distortion[0], plain.calibration.projector.distortion[0],
              1e-4);
}

TEST(GeometryFit, FifteenPosesReachTheCramerRaoBound) {
  const SyntheticRig rig = full_rig();
  double rotation_sum = 0, translation_sum = 0, rotation_bound = 0, translation_bound = 0;
  double place_sum = 0, flat_sum = 0, tilted_sum = 0;
  double normalised = 0;
  constexpr int kDraws = 20;
  for (int draw = 0; draw < kDraws; ++draw) {
    SCOPED_TRACE(draw);
    SyntheticBoards boards;
    boards.seed = static_cast<std::uint64_t>(100 + draw);
    const auto found = fit(rig, see_boards(rig, boards));
    ASSERT_TRUE(found) << found.error().text();
    EXPECT_TRUE(found->is_converged);
    EXPECT_LT(found->camera_rms_px, 0.2);
    EXPECT_LT(found->projector_rms_px, 0.2);
    EXPECT_NEAR(found->camera_noise_px, 0.1, 0.01);
    EXPECT_NEAR(found->projector_noise_px, 0.1, 0.01);
    const Vec3 turn = rotation_error_rad(found->calibration, rig.calibration);
    const Vec3 shift =
        found->calibration.projector_from_camera_mm - rig.calibration.projector_from_camera_mm;
    rotation_sum += turn.dot(turn);
    translation_sum += shift.dot(shift);
    rotation_bound += std::pow(found->rotation_sd_deg() * CV_PI / 180, 2);
    translation_bound += std::pow(found->translation_sd_mm(), 2);
    for (std::size_t i = 0; i < 3; ++i)
      normalised += std::pow(shift[static_cast<int>(i)] / found->sd(21 + i), 2) / 3;
    const PlaneError frontal = plane_error(rig, found->calibration, {0, 0, -1});
    const PlaneError tilted = plane_error(rig, found->calibration, {0.5, 0, -std::sqrt(0.75)});
    EXPECT_LT(frontal.flatness_mm, 0.1);
    place_sum += frontal.in_place_mm * frontal.in_place_mm;
    flat_sum += frontal.flatness_mm * frontal.flatness_mm;
    tilted_sum += tilted.in_place_mm * tilted.in_place_mm;
  }
  const auto rms = [](double sum) { return std::sqrt(sum / kDraws); };
  RecordProperty("rotation_rms_deg", std::to_string(rms(rotation_sum) * 180 / CV_PI));
  std::printf("rotation %.4f deg (bound %.4f), translation %.3f mm (bound %.3f), normalised %.2f\n",
              rms(rotation_sum) * 180 / CV_PI, rms(rotation_bound) * 180 / CV_PI,
              rms(translation_sum), rms(translation_bound), rms(normalised));
  std::printf("frontal plane: place %.4f mm, flatness %.4f mm; tilted 30 deg: place %.4f mm\n",
              rms(place_sum), rms(flat_sum), rms(tilted_sum));
  EXPECT_LT(rms(rotation_sum), 1.5 * rms(rotation_bound));
  EXPECT_LT(rms(translation_sum), 1.5 * rms(translation_bound));
  EXPECT_LT(rms(place_sum), 0.1);
  EXPECT_LT(rms(tilted_sum), 0.1);
}

// Projectors throw their picture upwards: the principal point lies at its lower edge.
TEST(GeometryFit, AProjectorWithAShiftedLensIsFound) {
  SyntheticRig rig = full_rig();
  rig.calibration.projector.K(1, 2) = 740;
  // Turned downwards by as much, so that it lights the same place.
  Mat3 down;
  cv::Rodrigues(Vec3((740 - 383.5) / 3400, 0, 0), down);
  rig.calibration.projector_from_camera = down * rig.calibration.projector_from_camera;
  rig.calibration.projector_from_camera_mm = down * rig.calibration.projector_from_camera_mm;
  const auto found = fit(rig, see_boards(rig, {}));
  ASSERT_TRUE(found) << found.error().text();
  EXPECT_LT(found->projector_rms_px, 0.2);
  EXPECT_LT(std::abs(found->calibration.projector.K(1, 2) - 740), 4 * found->sd(12));
  EXPECT_LT(cv::norm(rotation_error_rad(found->calibration, rig.calibration)) * 180 / CV_PI, 0.15);
}

TEST(GeometryFit, AThirdRadialTermIsFittedWhereTheLensHasOne) {
  SyntheticRig rig = full_rig();
  rig.calibration.camera.K(0, 0) = rig.calibration.camera.K(1, 1) = 1500;  // a wide lens
  rig.calibration.camera.distortion = {-0.3, 0.12, 0, 0, -0.08};
  SyntheticBoards boards;
  for (BoardPlace& place : boards.places) {
    place.middle_mm = {place.middle_mm[0] * 2.5, place.middle_mm[1] * 2.5,
                       place.middle_mm[2] * 0.35};
    place.tilt_x_deg *= 0.5;
    place.tilt_y_deg *= 0.5;
  }
  rig.projector = {4000, 3000, {}};
  rig.calibration.projector.K = Mat3(2500, 0, 2000, 0, 2500, 1500, 0, 0, 1);
  const std::vector<BoardPose> poses = see_boards(rig, boards);
  const auto found = fit_geometry(poses, kCameraSize, {4000, 3000});
  ASSERT_TRUE(found) << found.error().text();
  EXPECT_TRUE(found->has_camera_k3);
  EXPECT_LT(std::abs(found->calibration.camera.distortion[4] + 0.08), 4 * found->sd(8));
  const SyntheticRig plain = full_rig();  // its k3 moves no corner by a hundredth of a pixel
  const auto without = fit(plain, see_boards(plain, {}));
  ASSERT_TRUE(without);
  EXPECT_FALSE(without->has_camera_k3);
  EXPECT_EQ(without->calibration.camera.distortion[4], 0);
}

}  // namespace
}  // namespace estimation
