#include "hw_sim/world/board_scene.h"

#include <cmath>
#include <numbers>

namespace hw_sim {

using estimation::Mat3;
using estimation::Vec3;

namespace {

Mat3 about_axis(int axis, double angle_deg) {
  const double angle = angle_deg * std::numbers::pi / 180;
  const int a = (axis + 1) % 3, b = (axis + 2) % 3;
  Mat3 turn = Mat3::eye();
  turn(a, a) = turn(b, b) = std::cos(angle);
  turn(b, a) = std::sin(angle);
  turn(a, b) = -std::sin(angle);
  return turn;
}

struct Pose {
  Vec3 middle_mm;
  double tilt_x_deg, tilt_y_deg, spin_deg;
};

// As a patient operator would: all over the picture, turned every way, near and far.
const std::vector<Pose>& board_poses() {
  static const std::vector<Pose> poses{
      {{2, -3, 1002}, 2, -1, 1},   {{-28, -16, 985}, 33, 3, 4},    {{27, -18, 1012}, -34, -2, -5},
      {{-30, 15, 1006}, 4, 36, 3}, {{29, 17, 978}, -3, -37, 6},    {{3, 2, 945}, 28, 31, -2},
      {{-4, 5, 1056}, -29, 28, 9}, {{5, -6, 958}, 31, -33, -7},    {{-2, 4, 1048}, -30, -34, 1},
      {{-26, 2, 1075}, 2, 39, 11}, {{25, -3, 936}, 9, -36, -9},    {{4, -17, 1038}, 38, 6, -1},
      {{-3, 18, 962}, -38, 2, 2},  {{-22, 12, 1085}, -26, -24, 5}, {{21, -12, 930}, 24, 27, -4}};
  return poses;
}

Target checkerboard(const Pose& pose) {
  Target board;
  board.kind = Target::Kind::kCheckerboard;
  board.row_count = 10;
  board.col_count = 13;
  board.square_mm = 15;
  board.width_mm = (board.col_count + 2) * board.square_mm;
  board.height_mm = (board.row_count + 2) * board.square_mm;
  board.reflectance = 0.85;
  board.middle_mm = pose.middle_mm;
  board.tilt_x_deg = pose.tilt_x_deg;
  board.tilt_y_deg = pose.tilt_y_deg;
  board.spin_deg = pose.spin_deg;
  return board;
}

TargetScene board_scene() {
  TargetScene scene;
  for (const Pose& pose : board_poses()) {
    scene.steps.push_back(checkerboard(pose));
    scene.steps.back().name = "board, pose " + std::to_string(scene.steps.size());
  }
  return scene;
}

Target even_target(std::string name, double distance_mm, double tilt_y_deg, double reflectance) {
  Target target;
  target.name = std::move(name);
  target.width_mm = 360;
  target.height_mm = 270;
  target.middle_mm = {0, 0, distance_mm};
  target.tilt_x_deg = 1;
  target.tilt_y_deg = tilt_y_deg;
  target.reflectance = reflectance;
  return target;
}

TargetScene standard_scene(const std::vector<Spread>& spreads) {
  constexpr double kStandard = 0.99, kPaint = 0.8;
  constexpr double kFacingDeg = 7;  // half way to the projector
  Target cap;
  cap.name = "lens cap";
  cap.kind = Target::Kind::kCap;
  TargetScene scene;
  scene.steps.push_back(cap);
  for (const char* what : {"standard, for the exposures", "standard, for the patterns"})
    scene.steps.push_back(even_target(what, 1000, kFacingDeg, kStandard));
  scene.steps.push_back(even_target("opaque target, near", 950, kFacingDeg, kPaint));
  scene.steps.push_back(even_target("opaque target, in the middle", 1000, kFacingDeg, kPaint));
  scene.steps.push_back(even_target("opaque target, far", 1060, kFacingDeg, kPaint));
  for (Target& target : scene.steps)
    if (target.reflectance == kPaint) target.spreads = spreads;
  return scene;
}

// White plastic: a third comes back from its surface.
std::vector<Spread> plastic() { return {{0.35, 0.4}, {0.22, 1.1}, {0.1, 2.5}}; }

}  // namespace

Mat3 Target::rotation() const {
  return about_axis(1, tilt_y_deg) * about_axis(0, tilt_x_deg) * about_axis(2, spin_deg);
}

double Target::reflectance_at(double x_mm, double y_mm) const {
  const bool is_beside = std::abs(x_mm) > width_mm / 2 || std::abs(y_mm) > height_mm / 2;
  if (!is_there() || is_beside) return 0;
  if (kind == Kind::kEven) return reflectance;
  const double col = x_mm / square_mm + 0.5 * col_count;
  const double row = y_mm / square_mm + 0.5 * row_count;
  if (col < 0 || row < 0 || col >= col_count || row >= row_count) return reflectance;
  const bool is_ink = (static_cast<int>(col) + static_cast<int>(row)) % 2 == 0;
  return is_ink ? ink_reflectance : reflectance;
}

std::vector<std::string> target_scene_names() { return {"board", "standard", "translucent"}; }

rig::Result<TargetScene> make_target_scene(std::string_view name) {
  if (name == "board") return board_scene();
  if (name == "standard") return standard_scene({});
  if (name == "translucent") return standard_scene(plastic());
  return rig::failure(rig::Fault::kConfiguration, "there is no scene of targets \"" +
                                                      std::string(name) +
                                                      "\"; they are board, standard, translucent");
}

}  // namespace hw_sim
