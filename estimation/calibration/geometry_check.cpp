#include "estimation/calibration/geometry_check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "estimation/calibration/depth_bound.h"

namespace estimation {
namespace {

constexpr double kDegree = CV_PI / 180;

std::string number(double value, int digits, const char* unit = "") {
  char text[48];
  std::snprintf(text, sizeof text, "%.*f%s", digits, value, unit);
  return text;
}

Coverage cover(const GeometryFit& fit, bool is_projector, const Vec2& origin_px, int width_px,
               int height_px) {
  Coverage coverage{.corner_count = std::vector<int>(Coverage::kRows * Coverage::kCols)};
  for (const PoseFit& pose : fit.poses)
    for (const PoseFit::Residual& corner : pose.residuals) {
      if (is_projector && !corner.has_projector) continue;
      const Vec2 px = (is_projector ? corner.projector_px : corner.camera_px) - origin_px;
      const int col = static_cast<int>(std::floor((px[0] + 0.5) / width_px * Coverage::kCols));
      const int row = static_cast<int>(std::floor((px[1] + 0.5) / height_px * Coverage::kRows));
      if (col < 0 || row < 0 || col >= Coverage::kCols || row >= Coverage::kRows) continue;
      ++coverage.corner_count[static_cast<std::size_t>(row * Coverage::kCols + col)];
    }
  const auto covered = std::ranges::count_if(coverage.corner_count, [](int n) { return n > 0; });
  coverage.covered_frac =
      static_cast<double>(covered) / static_cast<double>(coverage.corner_count.size());
  return coverage;
}

double largest_tilt_deg(const GeometryFit& fit) {
  double largest = 0;
  for (const PoseFit& a : fit.poses)
    for (const PoseFit& b : fit.poses)
      largest = std::max(largest, std::acos(std::clamp(a.normal.dot(b.normal), -1.0, 1.0)));
  return largest / kDegree;
}

// Standard deviation of the normals' sideways parts in the direction where it is least.
double tilt_spread_deg(const std::vector<Vec3>& normals) {
  const double count = static_cast<double>(normals.size());
  Vec2 mean;
  for (const Vec3& normal : normals) mean += Vec2(normal[0], normal[1]) / count;
  double xx = 0, xy = 0, yy = 0;
  for (const Vec3& normal : normals) {
    const Vec2 d = Vec2(normal[0], normal[1]) - mean;
    xx += d[0] * d[0] / count;
    xy += d[0] * d[1] / count;
    yy += d[1] * d[1] / count;
  }
  const double least = (xx + yy) / 2 - std::hypot((xx - yy) / 2, xy);
  return std::sqrt(std::max(least, 0.0)) / kDegree;
}

std::vector<Vec3> normals_of(const GeometryFit& fit) {
  std::vector<Vec3> normals;
  for (const PoseFit& pose : fit.poses) normals.push_back(pose.normal);
  return normals;
}

SharedMatrix covariance_of(const GeometryFit& fit) { return SharedMatrix(fit.covariance.data()); }

double median_rms(const GeometryFit& fit, double PoseFit::*rms) {
  std::vector<double> values;
  for (const PoseFit& pose : fit.poses)
    if (pose.*rms > 0) values.push_back(pose.*rms);
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Poses that do not fit the others.
void refuse_outliers(const GeometryFit& fit, const GeometryLimits& limits, GeometryCheck& check) {
  const double camera_px = median_rms(fit, &PoseFit::camera_rms_px);
  const double projector_px = median_rms(fit, &PoseFit::projector_rms_px);
  const auto is_out = [&](double rms_px, double median_px) {
    return rms_px > std::max(limits.outlier_ratio * median_px, limits.outlier_least_rms_px);
  };
  for (const PoseFit& pose : fit.poses) {
    const bool is_camera = is_out(pose.camera_rms_px, camera_px);
    if (!is_camera && !is_out(pose.projector_rms_px, projector_px)) continue;
    const double rms_px = is_camera ? pose.camera_rms_px : pose.projector_rms_px;
    check.refusals.push_back(pose.name + " does not fit the others: its corners are off by " +
                             number(rms_px, 2, " px") + " rms in the " +
                             (is_camera ? "camera" : "projector") + ", the others' median is " +
                             number(is_camera ? camera_px : projector_px, 2, " px") +
                             "; did the board move or bend? Retake this pose or leave it out");
  }
}

void refuse_poverty(const GeometryFit& fit, const GeometryLimits& limits, double distance_mm,
                    GeometryCheck& check) {
  const auto refuse = [&check](const std::string& reason) { check.refusals.push_back(reason); };
  if (static_cast<int>(fit.poses.size()) < limits.min_pose_count)
    refuse(std::to_string(fit.poses.size()) + " poses are too few; show the board in at least " +
           std::to_string(limits.min_pose_count) + ", better 15");
  const auto refuse_coverage = [&](const Coverage& coverage, double least, const char* device) {
    if (coverage.covered_frac >= least) return;
    refuse("the corners cover " + number(100 * coverage.covered_frac, 0, "%") + " of the " +
           device + "'s picture, expected at least " + number(100 * least, 0, "%") +
           "; show the board near the picture's borders too");
  };
  refuse_coverage(check.camera, limits.min_camera_coverage_frac, "camera");
  refuse_coverage(check.projector, limits.min_projector_coverage_frac, "projector");
  if (check.largest_tilt_deg < limits.min_tilt_deg ||
      check.tilt_spread_deg < limits.min_tilt_spread_deg)
    refuse("the tilts are too alike (at most " + number(check.largest_tilt_deg, 0) +
           " degrees between two poses, a spread of " + number(check.tilt_spread_deg, 1) +
           " degrees in the direction that varies less); turn the board left, right, up and down "
           "by about 35 degrees");
  if (fit.camera_rms_px > limits.max_rms_px || fit.projector_rms_px > limits.max_rms_px)
    refuse("the corners are off by " + number(fit.camera_rms_px, 2, " px") +
           " rms in the camera and " + number(fit.projector_rms_px, 2, " px") +
           " in the projector, expected at most " + number(limits.max_rms_px, 1, " px") +
           "; is the board flat, are its squares all of one size, are the pictures sharp?");
  if (!fit.is_converged) refuse("the joint refinement did not converge; retake the poses");
  if (check.depth_sd_mm > limits.max_depth_sd_frac * distance_mm)
    refuse("a depth would be known to " + number(check.depth_sd_mm, 2, " mm") + " only, expected " +
           number(limits.max_depth_sd_frac * distance_mm, 2, " mm") +
           "; add poses, tilted more and larger in the picture");
}

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
                         : "turn the board by about " + number(kTurnDeg, 0) +
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

double usual_distance_mm(const GeometryFit& fit) {
  double sum = 0;
  for (const PoseFit& pose : fit.poses) sum += pose.distance_mm;
  return sum / static_cast<double>(fit.poses.size());
}

}  // namespace

GeometryCheck check_geometry(const GeometryFit& fit, const CameraInfo& camera,
                             const ProjectorInfo& projector, const GeometryLimits& limits) {
  GeometryCheck check;
  check.camera =
      cover(fit, false, Vec2(camera.roi_x_px, camera.roi_y_px), camera.width_px, camera.height_px);
  check.projector = cover(fit, true, Vec2(0, 0), projector.width_px, projector.height_px);
  check.largest_tilt_deg = largest_tilt_deg(fit);
  check.tilt_spread_deg = tilt_spread_deg(normals_of(fit));
  check.nearest_mm = std::numeric_limits<double>::infinity();
  for (const PoseFit& pose : fit.poses) {
    check.nearest_mm = std::min(check.nearest_mm, pose.distance_mm);
    check.farthest_mm = std::max(check.farthest_mm, pose.distance_mm);
  }
  check.depth_sd_mm = depth_sd_mm(
      depth_sensitivity(fit.calibration, camera, projector, check.nearest_mm, check.farthest_mm),
      covariance_of(fit));
  refuse_outliers(fit, limits, check);
  refuse_poverty(fit, limits, usual_distance_mm(fit), check);
  return check;
}

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
