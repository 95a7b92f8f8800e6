#include "estimation/calibration/pose_advice.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/calib3d.hpp>
#include <optional>
#include <vector>

#include "estimation/calibration/depth_bound.h"
#include "estimation/calibration/pose_statistics.h"

namespace estimation {
namespace {

// Below this spread of tilts the next pose must mend it, by this factor.
constexpr double kAmpleTiltSpreadDeg = 8;
constexpr double kTiltProgress = 1.15;

// Candidates for the next pose: how the board is turned, where it is in the picture, how far.
struct Turn {
  double x_deg, y_deg;  // about the picture's horizontal and vertical axis
  const char* faces;    // where the turned board faces
};
constexpr double kTurnDeg = 35;
// About y by a positive angle the board's face turns to the picture's left (its normal's x becomes
// negative); about x by a positive one it turns down.
constexpr std::array<Turn, 9> kTurns{{{0, 0, ""},
                                      {0, kTurnDeg, "left"},
                                      {0, -kTurnDeg, "right"},
                                      {-kTurnDeg, 0, "top"},
                                      {kTurnDeg, 0, "bottom"},
                                      {-kTurnDeg, kTurnDeg, "upper left"},
                                      {-kTurnDeg, -kTurnDeg, "upper right"},
                                      {kTurnDeg, kTurnDeg, "lower left"},
                                      {kTurnDeg, -kTurnDeg, "lower right"}}};

struct Place {
  double col_frac, row_frac;
  const char* name;
};
constexpr std::array<Place, 9> kPlaces{{{0.5, 0.5, "the middle"},
                                        {0.35, 0.35, "the upper left"},
                                        {0.65, 0.35, "the upper right"},
                                        {0.35, 0.65, "the lower left"},
                                        {0.65, 0.65, "the lower right"},
                                        {0.5, 0.35, "the top"},
                                        {0.5, 0.65, "the bottom"},
                                        {0.35, 0.5, "the left side"},
                                        {0.65, 0.5, "the right side"}}};

struct Reach {
  double factor;  // of the poses' usual distance
  const char* words;
};
constexpr std::array<Reach, 3> kReaches{
    {{1, ""}, {0.93, ", a little nearer to the camera"}, {1.07, ", a little farther away"}}};

std::string in_words(const Turn& turn, const Place& place, const Reach& reach) {
  std::string text = *turn.faces == 0
                         ? std::string("hold the board facing the camera")
                         : "turn the board by about " + std::to_string(static_cast<int>(kTurnDeg)) +
                               " degrees so that it faces the " + turn.faces + " of the picture";
  return text + ", near " + place.name + " of the picture" + reach.words;
}

PoseAdvice first_advice(std::size_t pose_count) {
  const std::size_t i = pose_count % kTurns.size();
  return {in_words(kTurns[i], kPlaces[i], kReaches[pose_count % kReaches.size()]), 0};
}

// The board at a candidate's place, its corners as camera and projector would have them; empty
// where too few of them would be seen.
struct Candidate {
  BoardPose pose;
  PoseVector place;
};

struct View {
  const GeometryFit& fit;
  const CameraInfo& camera;
  const ProjectorInfo& projector;
  SharedVector shared;
  double distance_mm;
};

Mat3 rotation_of(const Turn& turn) {
  Mat3 about_x, about_y;
  cv::Rodrigues(Vec3(turn.x_deg * kDegree, 0, 0), about_x);
  cv::Rodrigues(Vec3(0, turn.y_deg * kDegree, 0), about_y);
  return about_y * about_x;
}

Vec3 normal_of(const Turn& turn) { return rotation_of(turn) * Vec3(0, 0, -1); }

PoseVector place_board(const View& view, const Turn& turn, const Place& place, const Reach& reach,
                       const Vec2& middle_mm) {
  const CameraInfo& camera = view.camera;
  const Vec2 px(camera.roi_x_px + place.col_frac * camera.width_px,
                camera.roi_y_px + place.row_frac * camera.height_px);
  const auto seen = LensModel(view.fit.calibration.camera).unimage(px);
  const Vec2 toward = seen ? seen->normalized : Vec2(0, 0);
  const Vec3 direction(toward[0], toward[1], 1);
  const Vec3 middle = direction * (view.distance_mm * reach.factor / cv::norm(direction));
  const Mat3 rotation = rotation_of(turn);
  Vec3 vector;
  cv::Rodrigues(rotation, vector);
  const Vec3 t = middle - rotation * Vec3(middle_mm[0], middle_mm[1], 0);
  return {vector[0], vector[1], vector[2], t[0], t[1], t[2]};
}

std::optional<Candidate> candidate(const View& view, const PoseVector& place,
                                   std::span<const Vec2> board_mm) {
  Candidate found{{}, place};
  const auto is_inside = [](const Vec2& px, double width_px, double height_px) {
    return px[0] >= 0 && px[1] >= 0 && px[0] <= width_px - 1 && px[1] <= height_px - 1;
  };
  const Vec2 roi(view.camera.roi_x_px, view.camera.roi_y_px);
  for (const Vec2& at : board_mm) {
    const BoardPointImage image = image_board_point(view.shared, place, at);
    if (!image.is_in_front ||
        !is_inside(image.camera_px - roi, view.camera.width_px, view.camera.height_px))
      return std::nullopt;  // a checkerboard is found whole or not at all
    found.pose.corners.push_back(
        {.board_mm = at,
         .camera_px = image.camera_px,
         .projector_px = image.projector_px,
         .has_projector =
             is_inside(image.projector_px, view.projector.width_px, view.projector.height_px),
         .camera_sd_px = view.fit.camera_noise_px,
         .projector_sd_px = view.fit.projector_noise_px});
  }
  return found;
}

}  // namespace

PoseAdvice advise_pose(const GeometryFit* fit, std::size_t pose_count,
                       std::span<const Vec2> board_corners_mm, const CameraInfo& camera,
                       const ProjectorInfo& projector) {
  if (fit == nullptr || board_corners_mm.empty()) return first_advice(pose_count);
  const View view{*fit, camera, projector, shared_of(fit->calibration), usual_distance_mm(*fit)};
  Vec2 middle_mm;
  for (const Vec2& corner : board_corners_mm)
    middle_mm += corner / static_cast<double>(board_corners_mm.size());
  BundleOptions options;
  options.is_fixed[kK3] = !fit->has_camera_k3;
  options.is_fixed[kProjectorAt + kK3] = !fit->has_projector_k3;
  const SharedMatrix covariance = covariance_of(*fit);
  const auto information = invert_information(covariance, options);
  if (!information) return first_advice(pose_count);
  const SharedMatrix sensitivity = depth_sensitivity(
      fit->calibration, camera, projector, 0.9 * view.distance_mm, 1.1 * view.distance_mm);
  const double now_mm = depth_sd_mm(sensitivity, covariance);
  PoseAdvice best = first_advice(pose_count);
  // Tilts that are too alike come first: whatever the bound says, lenses are not as the model.
  const std::vector<Vec3> normals = normals_of(*fit);
  const double spread_deg = tilt_spread_deg(normals);
  const bool is_tilt_missing = spread_deg < kAmpleTiltSpreadDeg;
  for (const Turn& turn : kTurns) {
    std::vector<Vec3> with = normals;
    with.push_back(normal_of(turn));
    if (is_tilt_missing && tilt_spread_deg(with) < kTiltProgress * spread_deg) continue;
    for (const Place& place : kPlaces)
      for (const Reach& reach : kReaches) {
        const auto next =
            candidate(view, place_board(view, turn, place, reach, middle_mm), board_corners_mm);
        if (!next) continue;
        const SharedMatrix added =
            shared_information(next->pose, view.shared, next->place, options);
        const auto then = invert_information(*information + added, options);
        if (!then) continue;
        const double gain = 1 - depth_sd_mm(sensitivity, *then) / now_mm;
        if (gain > best.expected_gain_frac) best = {in_words(turn, place, reach), gain};
      }
  }
  return best;
}

}  // namespace estimation
