#include "estimation/calibration/geometry_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "estimation/calibration/pose_advice.h"
#include "estimation/geometry/triangulation.h"
#include "tests/estimation/calibration/synthetic_board.h"

namespace estimation {
namespace {

using ::testing::AllOf;
using testing::BoardPlace;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::make_rig;
using ::testing::Not;
using testing::see_boards;
using ::testing::SizeIs;
using testing::SyntheticBoards;
using testing::SyntheticRig;

constexpr ImageSize kCameraSize{2352, 1726}, kProjectorSize{1024, 768};

SyntheticRig full_rig() { return make_rig(kCameraSize.width_px, kCameraSize.height_px, true); }

std::vector<BoardPose> poses_at(const SyntheticRig& rig, std::vector<BoardPlace> places) {
  SyntheticBoards boards;
  boards.places = std::move(places);
  return see_boards(rig, boards);
}

GeometryFit fit_of(const std::vector<BoardPose>& poses) {
  auto fit = fit_geometry(poses, kCameraSize, kProjectorSize);
  if (!fit) {
    ADD_FAILURE() << fit.error().text();
    return {};
  }
  return *fit;
}

TEST(GeometryCheck, FifteenGoodPosesAreACalibration) {
  const SyntheticRig rig = full_rig();
  const GeometryFit fit = fit_of(poses_at(rig, testing::fifteen_places()));
  const GeometryCheck check = check_geometry(fit, rig.camera, rig.projector, {});
  EXPECT_THAT(check.refusals, IsEmpty());
  EXPECT_GT(check.camera.covered_frac, 0.8);
  EXPECT_GT(check.largest_tilt_deg, 60);
  EXPECT_GT(check.tilt_spread_deg, 15);
  EXPECT_GT(check.depth_sd_mm, 0.02);
  EXPECT_LT(check.depth_sd_mm, 0.15);
}

// The bound promises what a depth is worth; draws of the noise must keep the promise.
TEST(GeometryCheck, TheDepthsBoundIsWhatDepthsDo) {
  const SyntheticRig rig = full_rig();
  double error_sum = 0, bound_sum = 0;
  constexpr int kDraws = 12;
  for (int draw = 0; draw < kDraws; ++draw) {
    SyntheticBoards boards;
    boards.seed = static_cast<std::uint64_t>(draw + 1);
    const GeometryFit fit = fit_of(see_boards(rig, boards));
    const Stereo truth(rig.calibration, rig.camera), found(fit.calibration, rig.camera);
    double sum = 0;
    int count = 0;
    for (int row = 100; row < 1726; row += 300)
      for (int col = 100; col < 2352; col += 300) {
        const auto lit = truth.project(truth.ray(row, col)->direction * 1000);
        if (lit->pixel[0] < 0 || lit->pixel[0] > 1023) continue;
        const auto depth =
            found.triangulate(*found.ray(row, col), {lit->pixel[0], 0.01, lit->pixel[1], 0.01});
        sum += std::pow(depth->depth_mm - 1000, 2);
        ++count;
      }
    error_sum += sum / count;
    bound_sum += std::pow(check_geometry(fit, rig.camera, rig.projector, {}).depth_sd_mm, 2);
  }
  EXPECT_NEAR(std::sqrt(error_sum / bound_sum), 1, 0.35);
}

TEST(GeometryCheck, TooFewPosesAreRefused) {
  const SyntheticRig rig = full_rig();
  std::vector<BoardPlace> places = testing::fifteen_places();
  places.resize(5);
  const GeometryCheck check =
      check_geometry(fit_of(poses_at(rig, places)), rig.camera, rig.projector, {});
  EXPECT_THAT(check.refusals, Contains(HasSubstr("5 poses are too few")));
  const auto none =
      fit_geometry(poses_at(rig, {BoardPlace{}, BoardPlace{}}), kCameraSize, kProjectorSize);
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().text(), HasSubstr("2 poses"));
}

TEST(GeometryCheck, TiltsAboutOneAxisAloneAreRefused) {
  const SyntheticRig rig = full_rig();
  std::vector<BoardPlace> places;
  for (int i = 0; i < 8; ++i)
    places.push_back({{10.0 * (i - 4), 5.0 * (i % 3), 980.0 + 10 * i}, 0, 10.0 * (i - 4) + 1, 0});
  const GeometryFit fit = fit_of(poses_at(rig, places));
  const GeometryCheck check = check_geometry(fit, rig.camera, rig.projector, {});
  EXPECT_THAT(check.refusals, Contains(HasSubstr("tilts are too alike")));
}

TEST(GeometryCheck, ACornerOfThePictureAloneIsRefused) {
  const SyntheticRig rig = full_rig();
  SyntheticBoards boards;
  boards.shape = {5, 6, 10};
  for (BoardPlace& place : boards.places)
    place.middle_mm = {place.middle_mm[0] / 5 + 60, place.middle_mm[1] / 5 + 40, 1000};
  const GeometryCheck check =
      check_geometry(fit_of(see_boards(rig, boards)), rig.camera, rig.projector, {});
  EXPECT_THAT(check.refusals, Contains(AllOf(HasSubstr("cover"), HasSubstr("camera's picture"))));
}

TEST(GeometryCheck, APoseThatMovedIsNamed) {
  const SyntheticRig rig = full_rig();
  std::vector<BoardPose> poses = poses_at(rig, testing::fifteen_places());
  // The board slid by half a millimetre between the white picture and the codes.
  for (BoardCorner& corner : poses[6].corners) corner.projector_px += Vec2(1.7, 0.6);
  const GeometryCheck check = check_geometry(fit_of(poses), rig.camera, rig.projector, {});
  ASSERT_THAT(check.refusals, SizeIs(1));
  EXPECT_THAT(check.refusals[0], AllOf(HasSubstr("pose 7"), HasSubstr("Retake")));
}

TEST(PoseAdvice, AsksForTheTiltThatIsMissing) {
  const SyntheticRig rig = full_rig();
  // Turned about the vertical axis alone: up and down is what is missing.
  std::vector<BoardPlace> places;
  for (int i = 0; i < 6; ++i)
    places.push_back({{10.0 * (i - 3), 0, 980.0 + 10 * i}, i == 0 ? 4.0 : 0.0, 14.0 * (i - 3), 0});
  const GeometryFit fit = fit_of(poses_at(rig, places));
  const std::vector<Vec2> corners = testing::board_corners({});
  const PoseAdvice advice = advise_pose(&fit, fit.poses.size(), corners, rig.camera, rig.projector);
  EXPECT_GT(advice.expected_gain_frac, 0.1);
  EXPECT_THAT(advice.text, ::testing::AnyOf(HasSubstr("top"), HasSubstr("bottom"),
                                            HasSubstr("upper"), HasSubstr("lower")))
      << advice.text;
}

// What is advised, done, is worth what was promised.
TEST(PoseAdvice, FollowingItReachesACalibrationSoonerThanMorePosesOfTheSame) {
  const SyntheticRig rig = full_rig();
  const GeometryFit fit = fit_of(poses_at(rig, testing::fifteen_places()));
  const PoseAdvice late =
      advise_pose(&fit, 15, testing::board_corners({}), rig.camera, rig.projector);
  std::vector<BoardPlace> few = testing::fifteen_places();
  few.resize(4);
  const GeometryFit early_fit = fit_of(poses_at(rig, few));
  const PoseAdvice early =
      advise_pose(&early_fit, 4, testing::board_corners({}), rig.camera, rig.projector);
  EXPECT_GT(early.expected_gain_frac, late.expected_gain_frac);
  EXPECT_LT(late.expected_gain_frac, 0.15);
}

TEST(PoseAdvice, BeginsFacingTheCamera) {
  const SyntheticRig rig = full_rig();
  EXPECT_THAT(advise_pose(nullptr, 0, {}, rig.camera, rig.projector).text,
              HasSubstr("facing the camera"));
  EXPECT_THAT(advise_pose(nullptr, 1, {}, rig.camera, rig.projector).text,
              AllOf(HasSubstr("faces the left"), Not(HasSubstr("facing"))));
}

}  // namespace
}  // namespace estimation
