#include "estimation/calibration/board_observation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/aruco/charuco.hpp>

#include "estimation/calibration/geometry_fit.h"
#include "tests/estimation/calibration/rendered_board.h"

namespace estimation {
namespace {

using testing::BoardShape;
using ::testing::HasSubstr;
using testing::make_rig;
using testing::RenderedFrames;
using testing::RenderedPose;
using testing::RenderSettings;
using testing::RigidPlace;
using ::testing::SizeIs;
using testing::SyntheticRig;

constexpr int kWidthPx = 784, kHeightPx = 576;

CorrespondenceOptions decoding(const RenderSettings& settings) {
  CorrespondenceOptions options;
  options.noise = {
      {.read_variance = settings.read_sd * settings.read_sd, .shot_dn_per_us = settings.shot}};
  return options;
}

struct CornerErrors {
  double camera_rms_px = 0, projector_rms_px = 0, epipolar_rms_px = 0;
  int lit_count = 0;
};

// Against where the board's corners truly are. A checkerboard may come turned by half a turn.
CornerErrors errors_of(const BoardPose& pose, const SyntheticRig& rig, const RigidPlace& place,
                       const BoardShape& shape) {
  CornerErrors errors;
  const Vec2 far(shape.square_mm * (shape.cols - 1), shape.square_mm * (shape.rows - 1));
  bool is_turned = false;
  for (const bool turned : {false, true}) {
    const Vec2 at = turned ? far - pose.corners[0].board_mm : pose.corners[0].board_mm;
    const Vec3 point = place.rotation * Vec3(at[0], at[1], 0) + place.translation_mm;
    const Vec2 seen = testing::opencv_pixel(rig.calibration.camera, point);
    if (cv::norm(seen - pose.corners[0].camera_px) < 3) is_turned = turned;
  }
  for (const BoardCorner& corner : pose.corners) {
    const Vec2 at = is_turned ? far - corner.board_mm : corner.board_mm;
    const Vec3 point = place.rotation * Vec3(at[0], at[1], 0) + place.translation_mm;
    const Vec2 seen = corner.camera_px - testing::opencv_pixel(rig.calibration.camera, point);
    errors.camera_rms_px += seen.dot(seen);
    if (!corner.has_projector) continue;
    ++errors.lit_count;
    const Vec2 lit = corner.projector_px - testing::projector_pixel(rig, point);
    const Vec2 alone = lit - corner.projector_by_camera * seen;
    errors.projector_rms_px += lit.dot(lit);
    errors.epipolar_rms_px += alone.dot(alone);
  }
  errors.camera_rms_px = std::sqrt(errors.camera_rms_px / static_cast<double>(pose.corners.size()));
  errors.projector_rms_px = std::sqrt(errors.projector_rms_px / errors.lit_count);
  errors.epipolar_rms_px = std::sqrt(errors.epipolar_rms_px / errors.lit_count);
  return errors;
}

TEST(BoardObservation, CornersAreFoundAndLitToAFewHundredthsOfAPixel) {
  const SyntheticRig rig = make_rig(kWidthPx, kHeightPx, true);
  const BoardShape shape{7, 9, 18};
  const RenderSettings settings;
  const RigidPlace place = rigid({{5, -3, 1000}, 20, -25, 4}, shape);
  const RenderedFrames frames(RenderedPose(rig, place, testing::checkerboard(shape), settings),
                              testing::board_kinds());
  const Board board{BoardKind::kCheckerboard, 8, 10, 18};
  const auto pose =
      observe_board("one", frames.signals(), board, rig.camera, rig.projector, decoding(settings));
  ASSERT_TRUE(pose) << pose.error().text();
  ASSERT_THAT(pose->corners, SizeIs(63));
  const CornerErrors errors = errors_of(*pose, rig, place, shape);
  std::printf("camera %.4f px, projector %.4f px, alone %.4f px\n", errors.camera_rms_px,
              errors.projector_rms_px, errors.epipolar_rms_px);
  EXPECT_EQ(errors.lit_count, 63);
  EXPECT_LT(errors.camera_rms_px, 0.02);
  EXPECT_LT(errors.epipolar_rms_px, 0.01);
}

// The paper's four shifts of the fine stripes err by 0.45 px rms in a ripple of 4 px, and a board
// turned about its upright axis alone has whole columns of pixels at the same place of the ripple.
TEST(BoardObservation, StripesAlongThePixelsDoNotPullTheirCorners) {
  const SyntheticRig rig = make_rig(588, 432, false);
  const BoardShape shape{7, 9, 18};
  RenderSettings settings;
  settings.projector_blur_px = 0.7;
  settings.camera_blur_px = 0.5;
  const RigidPlace place = rigid({{-4, 2, 1000}, 1, 36, 0.5}, shape);
  const RenderedFrames frames(RenderedPose(rig, place, testing::checkerboard(shape), settings),
                              testing::board_kinds());
  const Board board{BoardKind::kCheckerboard, 8, 10, 18};
  const auto pose =
      observe_board("one", frames.signals(), board, rig.camera, rig.projector, decoding(settings));
  ASSERT_TRUE(pose) << pose.error().text();
  const CornerErrors errors = errors_of(*pose, rig, place, shape);
  std::printf("camera %.4f px, alone %.4f px\n", errors.camera_rms_px, errors.epipolar_rms_px);
  EXPECT_EQ(errors.lit_count, 63);
  EXPECT_LT(errors.epipolar_rms_px, 0.01);
}

TEST(BoardObservation, RipplesAreThoseOfEvenShifts) {
  const Image<float> signal(4, 4);
  const auto ripple_of = [&](const std::vector<int>& shifts) {
    std::vector<PatternKind> kinds{White{}};
    for (const int shift : shifts) kinds.emplace_back(Stripes{Axis::kRow, 16, 8, shift});
    std::vector<PatternSignal> signals;
    for (const PatternKind& kind : kinds) signals.push_back({&kind, signal.view()});
    const PhaseRipples ripples = phase_ripples(signals);
    EXPECT_EQ(ripples.column.period_px, 0);
    return ripples.row;
  };
  const PhaseRipple four = ripple_of({0, 4, 8, 12});
  EXPECT_EQ(four.period_px, 4);
  EXPECT_EQ(four.zero_px, 3.5);                                // a stripe's middle
  EXPECT_NEAR(four.greatest_px, 16 / (2 * CV_PI) / 3, 1e-12);  // the third harmonic's third
  EXPECT_EQ(ripple_of({14, 2, 6, 10, -4, 0, 4, 8}).period_px, 2);
  EXPECT_EQ(ripple_of({0, 4, 8}).period_px, 0);
  EXPECT_EQ(ripple_of({0, 1, 8, 12}).period_px, 0);
}

// As OpenCV draws it; the board's corners are counted from its first inner corner.
testing::Albedo charuco(const Board& board) {
  const auto square = static_cast<float>(board.square_mm);
  const auto drawn = cv::aruco::CharucoBoard::create(
      board.col_count, board.row_count, square, square * static_cast<float>(kCharucoMarkerFrac),
      cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_250));
  constexpr int kSquarePx = 56;  // a whole number of px a marker's cell
  cv::Mat1b picture;
  drawn->draw({board.col_count * kSquarePx, board.row_count * kSquarePx}, picture);
  return [picture, board](double x_mm, double y_mm) {
    const double x = (x_mm / board.square_mm + 1) * kSquarePx;
    const double y = (y_mm / board.square_mm + 1) * kSquarePx;
    if (x < 0 || y < 0 || x >= picture.cols || y >= picture.rows) return testing::kPaper;
    const bool is_black = picture(static_cast<int>(y), static_cast<int>(x)) < 128;
    return is_black ? testing::kInkOfBoard : testing::kPaper;
  };
}

TEST(BoardObservation, ACharucoBoardMayBePartlyOutsideUnderABayerMosaic) {
  SyntheticRig rig = make_rig(kWidthPx, kHeightPx, true);
  rig.camera.pixel_format = {ColorFilter::kBayerRG, 12};
  const Board board{BoardKind::kCharuco, 7, 10, 28};
  const BoardShape shape{board.row_count - 1, board.col_count - 1, board.square_mm};
  RenderSettings settings;
  settings.site_gain = {0.6, 1, 1, 0.5};
  const RigidPlace place = rigid({{60, 10, 1000}, -10, 20, -3}, shape);
  const RenderedFrames frames(RenderedPose(rig, place, charuco(board), settings),
                              testing::board_kinds());
  const auto pose =
      observe_board("one", frames.signals(), board, rig.camera, rig.projector, decoding(settings));
  ASSERT_TRUE(pose) << pose.error().text();
  EXPECT_GT(pose->corners.size(), 25U);
  EXPECT_LT(pose->corners.size(), 54U);
  const CornerErrors errors = errors_of(*pose, rig, place, shape);
  std::printf("%zu corners: camera %.4f px, projector %.4f px, alone %.4f px\n",
              pose->corners.size(), errors.camera_rms_px, errors.projector_rms_px,
              errors.epipolar_rms_px);
  EXPECT_GT(errors.lit_count, 20);
  EXPECT_LT(errors.camera_rms_px, 0.025);
  EXPECT_LT(errors.epipolar_rms_px, 0.025);
}

TEST(BoardObservation, APictureWithoutABoardIsRefusedWithTheReason) {
  const SyntheticRig rig = make_rig(392, 288, false);
  const RigidPlace place = rigid({{0, 0, 1000}, 0, 0, 0}, BoardShape{});
  const RenderedFrames frames(RenderedPose(
                                  rig, place, [](double, double) { return 0.5; }, RenderSettings{}),
                              testing::board_kinds());
  const auto pose = observe_board("blank", frames.signals(), {BoardKind::kCheckerboard, 8, 10, 18},
                                  rig.camera, rig.projector, decoding(RenderSettings{}));
  ASSERT_FALSE(pose);
  EXPECT_THAT(pose.error().text(), HasSubstr("blank"));
  EXPECT_THAT(pose.error().text(), HasSubstr("counts are of squares"));
}

TEST(BoardObservation, ABoardIsReadFromWords) {
  const auto board = parse_board("charuco", "11x15", 18.5);
  ASSERT_TRUE(board);
  EXPECT_EQ(board->kind, BoardKind::kCharuco);
  EXPECT_EQ(board->row_count, 11);
  EXPECT_EQ(board->col_count, 15);
  const auto wrong = parse_board("chequers", "11", 0);
  ASSERT_FALSE(wrong);
  EXPECT_THAT(wrong.error().text(), HasSubstr("chequers"));
  EXPECT_THAT(wrong.error().text(), HasSubstr("ROWSxCOLS"));
  EXPECT_THAT(wrong.error().text(), HasSubstr("above 0 mm"));
}

TEST(BoardObservation, FromFramesToACalibration) {
  const SyntheticRig rig = make_rig(490, 360, true);
  const BoardShape shape{7, 9, 18};
  RenderSettings settings;
  std::vector<BoardPose> poses;
  std::vector<testing::BoardPlace> places = testing::fifteen_places();
  places.resize(9);
  for (const testing::BoardPlace& place : places) {
    ++settings.seed;
    const RenderedFrames frames(
        RenderedPose(rig, rigid(place, shape), testing::checkerboard(shape), settings),
        testing::board_kinds());
    const Board board{BoardKind::kCheckerboard, 8, 10, 18};
    const auto pose = observe_board("pose " + std::to_string(poses.size() + 1), frames.signals(),
                                    board, rig.camera, rig.projector, decoding(settings));
    ASSERT_TRUE(pose) << pose.error().text();
    poses.push_back(*pose);
  }
  const auto fit = fit_geometry(poses, {490, 360}, {1024, 768});
  ASSERT_TRUE(fit) << fit.error().text();
  Vec3 turn;
  cv::Rodrigues(fit->calibration.projector_from_camera * rig.calibration.projector_from_camera.t(),
                turn);
  const Vec3 shift =
      fit->calibration.projector_from_camera_mm - rig.calibration.projector_from_camera_mm;
  std::printf("rms %.4f %.4f px, noise %.4f %.4f px; off by %.4f deg (%.4f), %.4f mm (%.4f)\n",
              fit->camera_rms_px, fit->projector_rms_px, fit->camera_noise_px,
              fit->projector_noise_px, cv::norm(turn) * 180 / CV_PI, fit->rotation_sd_deg(),
              cv::norm(shift), fit->translation_sd_mm());
  EXPECT_LT(fit->camera_rms_px, 0.03);
  EXPECT_LT(fit->projector_rms_px, 0.06);
  EXPECT_LT(cv::norm(turn) * 180 / CV_PI, 0.03);
  EXPECT_LT(cv::norm(shift), 0.3);
}

}  // namespace
}  // namespace estimation
