// A flat board of corners held in front of the synthetic rig, and where its camera and projector
// have them: by OpenCV's own projectPoints, with noise that is the same with every library.
#pragma once

#include <cmath>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "estimation/calibration/board_view.h"
#include "tests/estimation/geometry/synthetic_frames.h"
#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation::testing {

struct BoardShape {
  int rows = 10, cols = 14;  // of inner corners
  double square_mm = 18;
};

// Where the board is held: its middle, and how it is turned from facing the camera.
struct BoardPlace {
  Vec3 middle_mm{0, 0, 1000};
  double tilt_x_deg = 0, tilt_y_deg = 0, spin_deg = 0;
};

inline std::vector<Vec2> board_corners(const BoardShape& shape) {
  std::vector<Vec2> corners;
  for (int row = 0; row < shape.rows; ++row)
    for (int col = 0; col < shape.cols; ++col)
      corners.emplace_back(shape.square_mm * col, shape.square_mm * row);
  return corners;
}

struct RigidPlace {
  Mat3 rotation;
  Vec3 translation_mm;  // X_c = R X_b + t
};

inline RigidPlace rigid(const BoardPlace& place, const BoardShape& shape) {
  const double degree = CV_PI / 180;
  Mat3 about_x, about_y, about_z;
  cv::Rodrigues(Vec3(place.tilt_x_deg * degree, 0, 0), about_x);
  cv::Rodrigues(Vec3(0, place.tilt_y_deg * degree, 0), about_y);
  cv::Rodrigues(Vec3(0, 0, place.spin_deg * degree), about_z);
  const Mat3 rotation = about_y * about_x * about_z;
  const Vec3 middle(shape.square_mm * (shape.cols - 1) / 2, shape.square_mm * (shape.rows - 1) / 2,
                    0);
  return {rotation, place.middle_mm - rotation * middle};
}

// Fifteen ways to hold it, as guidance would ask for.
inline std::vector<BoardPlace> fifteen_places() {
  return {
      {{0, 0, 1000}, 0, 0, 0},     {{-35, -25, 990}, 35, 0, 3},    {{35, -25, 1010}, -35, 0, -4},
      {{-35, 25, 1000}, 0, 38, 2}, {{35, 25, 985}, 0, -35, 5},     {{0, 0, 940}, 30, 30, 0},
      {{0, 0, 1060}, -28, 30, 8},  {{0, 0, 950}, 30, -35, -6},     {{0, 0, 1050}, -30, -33, 0},
      {{-30, 0, 1080}, 0, 40, 10}, {{30, 0, 930}, 10, -38, -10},   {{0, -25, 1040}, 40, 5, 0},
      {{0, 25, 960}, -40, 0, 0},   {{-25, 15, 1100}, -25, -25, 4}, {{25, -15, 920}, 25, 25, -3}};
}

struct SyntheticBoards {
  BoardShape shape;
  std::vector<BoardPlace> places = fifteen_places();
  double camera_noise_px = 0.1, projector_noise_px = 0.1;
  std::uint64_t seed = 1;
};

// Corners outside the camera's picture are not there; those outside the projector's are not lit.
inline std::vector<BoardPose> see_boards(const SyntheticRig& rig, const SyntheticBoards& boards) {
  NormalDeviates deviates(boards.seed);
  std::vector<BoardPose> poses;
  for (const BoardPlace& place : boards.places) {
    const RigidPlace at = rigid(place, boards.shape);
    BoardPose pose{"pose " + std::to_string(poses.size() + 1), {}};
    for (const Vec2& corner : board_corners(boards.shape)) {
      const Vec3 point = at.rotation * Vec3(corner[0], corner[1], 0) + at.translation_mm;
      const Vec2 seen = opencv_pixel(rig.calibration.camera, point);
      const Vec2 lit = projector_pixel(rig, point);
      if (seen[0] < 0 || seen[1] < 0 || seen[0] > rig.camera.width_px - 1 ||
          seen[1] > rig.camera.height_px - 1)
        continue;
      BoardCorner view{.board_mm = corner, .camera_px = seen, .projector_px = lit};
      view.has_projector = lit[0] >= 0 && lit[1] >= 0 && lit[0] <= rig.projector.width_px - 1 &&
                           lit[1] <= rig.projector.height_px - 1;
      view.camera_px += boards.camera_noise_px * Vec2(deviates.next(), deviates.next());
      view.projector_px += boards.projector_noise_px * Vec2(deviates.next(), deviates.next());
      pose.corners.push_back(view);
    }
    poses.push_back(std::move(pose));
  }
  return poses;
}

}  // namespace estimation::testing
