#include "estimation/calibration/geometry_fit.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "estimation/calibration/bundle.h"

namespace estimation {

const std::array<const char*, kGeometryParameterCount> kGeometryParameterNames{
    "camera fx",    "camera fy",     "camera cx",     "camera cy",    "camera k1",
    "camera k2",    "camera p1",     "camera p2",     "camera k3",    "projector fx",
    "projector fy", "projector cx",  "projector cy",  "projector k1", "projector k2",
    "projector p1", "projector p2",  "projector k3",  "rotation x",   "rotation y",
    "rotation z",   "translation x", "translation y", "translation z"};

namespace {

constexpr int kLeastCorners = 6;
constexpr int kLeastPoses = 3;
// Twice the logarithm of the likelihood ratio by which a k3 must pay: 3.3 standard deviations.
constexpr double kK3Gain = 11;
// The median of a squared residual's two coordinates is 2 ln 2 times the variance of one.
const double kMedianOfSquares = 2 * std::log(2.0);
constexpr int kScaleRounds = 8;
// A pose's own noise is weighed against that of all poses as so many corners.
constexpr double kPriorCorners = 20;
// What a pose's projector coordinates err by together (0.0005 px in ray-traced poses) does not
// average over its hundred corners: as much as this would that is each corner's own.
constexpr double kLeastProjectorSdPx = 0.005;

tl::unexpected<InputError> insufficient(const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", expectation});
}

enum class Device { kCamera, kProjector };

// One device alone, by OpenCV: a start for the joint refinement. Which poses, and where they were.
struct Alone {
  Lens lens;
  std::vector<std::size_t> poses;
  std::vector<Mat3> rotations;
  std::vector<Vec3> translations_mm;
};

Alone calibrate_alone(std::span<const BoardPose> poses, Device device, ImageSize size) {
  Alone alone;
  std::vector<std::vector<cv::Point3f>> board;
  std::vector<std::vector<cv::Point2f>> pixels;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    std::vector<cv::Point3f> points;
    std::vector<cv::Point2f> seen;
    for (const BoardCorner& corner : poses[i].corners) {
      if (device == Device::kProjector && !corner.has_projector) continue;
      const Vec2& px = device == Device::kCamera ? corner.camera_px : corner.projector_px;
      points.emplace_back(cv::Point2f(cv::Point2d(corner.board_mm)).x,
                          cv::Point2f(cv::Point2d(corner.board_mm)).y, 0.0F);
      seen.emplace_back(cv::Point2d(px));
    }
    if (static_cast<int>(points.size()) < kLeastCorners) continue;
    alone.poses.push_back(i);
    board.push_back(std::move(points));
    pixels.push_back(std::move(seen));
  }
  if (alone.poses.size() < kLeastPoses) return alone;
  cv::Mat K, distortion, rotations, translations;
  constexpr int kFlags = cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3;
  cv::calibrateCamera(board, pixels, {size.width_px, size.height_px}, K, distortion, rotations,
                      translations, kFlags);
  alone.lens.K = cv::Matx33d(K);
  alone.lens.distortion[0] = distortion.at<double>(0);
  for (int i = 0; i < static_cast<int>(alone.poses.size()); ++i) {
    Mat3 rotation;
    cv::Rodrigues(rotations.at<Vec3>(i), rotation);
    alone.rotations.push_back(rotation);
    alone.translations_mm.push_back(translations.at<Vec3>(i));
  }
  return alone;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// How the projector stands, from each pose seen by both: the median of each number, made a rotation
// again. A pose that went wrong does not matter.
void relate(const Alone& camera, const Alone& projector, Calibration& calibration) {
  std::vector<std::vector<double>> numbers(12);
  for (std::size_t k = 0; k < projector.poses.size(); ++k) {
    const auto found = std::ranges::find(camera.poses, projector.poses[k]);
    if (found == camera.poses.end()) continue;
    const auto c = static_cast<std::size_t>(found - camera.poses.begin());
    const Mat3 rotation = projector.rotations[k] * camera.rotations[c].t();
    const Vec3 translation = projector.translations_mm[k] - rotation * camera.translations_mm[c];
    for (std::size_t i = 0; i < 9; ++i) numbers[i].push_back(rotation.val[i]);
    for (std::size_t i = 0; i < 3; ++i) numbers[9 + i].push_back(translation[static_cast<int>(i)]);
  }
  Mat3 rotation;
  for (std::size_t i = 0; i < 9; ++i) rotation.val[i] = median(numbers[i]);
  for (std::size_t i = 0; i < 3; ++i)
    calibration.projector_from_camera_mm[static_cast<int>(i)] = median(numbers[9 + i]);
  cv::Matx33d u, vt;
  cv::Matx31d w;
  cv::SVD::compute(rotation, w, u, vt);
  calibration.projector_from_camera = u * vt;
}

PoseVector pose_vector(const Mat3& rotation, const Vec3& translation_mm) {
  Vec3 vector;
  cv::Rodrigues(rotation, vector);
  return {vector[0], vector[1], vector[2], translation_mm[0], translation_mm[1], translation_mm[2]};
}

Result<BundleState> start_state(std::span<const BoardPose> poses, ImageSize camera_size,
                                ImageSize projector_size) {
  const Alone camera = calibrate_alone(poses, Device::kCamera, camera_size);
  const Alone projector = calibrate_alone(poses, Device::kProjector, projector_size);
  if (projector.poses.size() < kLeastPoses)
    return insufficient(std::to_string(projector.poses.size()) + " poses have " +
                        std::to_string(kLeastCorners) +
                        " or more corners decoded in projector pixels; expected at least " +
                        std::to_string(kLeastPoses));
  Calibration calibration;
  calibration.camera = camera.lens;
  calibration.projector = projector.lens;
  relate(camera, projector, calibration);
  BundleState state{shared_of(calibration), {}};
  for (std::size_t i = 0; i < poses.size(); ++i)
    state.poses.push_back(pose_vector(camera.rotations[i], camera.translations_mm[i]));
  return state;
}

// How many times their own claim one coordinate of these corners is off, robustly: squares beyond
// the bundle's bound count as that bound. `squares`: of both coordinates of a corner together, in
// claimed variances.
double noise_over_claim(const std::vector<double>& squares, double freedom_frac, double prior,
                        double prior_weight) {
  const double bound = BundleOptions{}.robust_sd * BundleOptions{}.robust_sd;
  const double usual =
      2 * (1 - std::exp(-bound / 2));  // mean of the clipped square without outliers
  double variance = prior > 0 ? prior * prior : std::max(median(squares), 1e-12) / kMedianOfSquares;
  for (int round = 0; round < kScaleRounds; ++round) {
    double sum = prior_weight * prior * prior;
    for (const double square : squares)
      sum += std::min(square / variance, bound) * variance / usual / freedom_frac;
    variance = std::max(sum / (prior_weight + static_cast<double>(squares.size())), 1e-12);
  }
  return std::sqrt(variance);
}

// Each pose's corners with the noise that the residuals show. Poses differ: in sharpness, in how
// the board's edges lie to the pixels, in whether the board was still.
std::vector<BoardPose> rescaled(std::span<const BoardPose> poses, const BundleResult& result,
                                int parameter_count) {
  std::vector<std::vector<double>> camera(poses.size()), projector(poses.size());
  std::vector<double> all_camera, all_projector;
  for (std::size_t i = 0; i < poses.size(); ++i)
    for (std::size_t k = 0; k < poses[i].corners.size(); ++k) {
      const BoardCorner& corner = poses[i].corners[k];
      const CornerResidual& r = result.residuals[i][k];
      camera[i].push_back(r.camera_px.dot(r.camera_px) /
                          (corner.camera_sd_px * corner.camera_sd_px));
      all_camera.push_back(camera[i].back());
      if (!corner.has_projector) continue;
      projector[i].push_back(r.projector_alone_px.dot(r.projector_alone_px) /
                             (corner.projector_sd_px * corner.projector_sd_px));
      all_projector.push_back(projector[i].back());
    }
  const double count = 2 * static_cast<double>(all_camera.size() + all_projector.size());
  const double freedom_frac = std::max(1.0, count - parameter_count) / count;
  const double camera_scale = noise_over_claim(all_camera, freedom_frac, 0, 0);
  const double projector_scale = noise_over_claim(all_projector, freedom_frac, 0, 0);
  std::vector<BoardPose> result_poses(poses.begin(), poses.end());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const double own_camera =
        noise_over_claim(camera[i], freedom_frac, camera_scale, kPriorCorners);
    const double own_projector =
        noise_over_claim(projector[i], freedom_frac, projector_scale, kPriorCorners);
    for (BoardCorner& corner : result_poses[i].corners) {
      corner.camera_sd_px *= own_camera;
      corner.projector_sd_px =
          std::max(own_projector * corner.projector_sd_px, kLeastProjectorSdPx);
    }
  }
  return result_poses;
}

BundleOptions without_k3() {
  BundleOptions options;
  options.is_fixed[kK3] = options.is_fixed[kProjectorAt + kK3] = true;
  return options;
}

SharedMatrix information_of(std::span<const BoardPose> poses, const BundleState& state,
                            const BundleOptions& options) {
  SharedMatrix information = SharedMatrix::zeros();
  for (std::size_t i = 0; i < poses.size(); ++i)
    information += shared_information(poses[i], state.shared, state.poses[i], options);
  return information;
}

std::vector<double> flat(const SharedMatrix& matrix) {
  return {std::begin(matrix.val), std::end(matrix.val)};
}

double rms_of(double sum, int count) { return count > 0 ? std::sqrt(sum / count) : 0; }

PoseFit pose_fit(const BoardPose& pose, const PoseVector& place,
                 const std::vector<CornerResidual>& residuals) {
  PoseFit fit{.name = pose.name,
              .rotation_rad = {place(0), place(1), place(2)},
              .translation_mm = {place(3), place(4), place(5)},
              .normal = {},
              .corner_count = static_cast<int>(pose.corners.size()),
              .residuals = {}};
  Mat3 rotation;
  cv::Rodrigues(fit.rotation_rad, rotation);
  Vec2 middle_mm;
  double camera_sum = 0, projector_sum = 0;
  for (std::size_t i = 0; i < pose.corners.size(); ++i) {
    const BoardCorner& corner = pose.corners[i];
    const CornerResidual& r = residuals[i];
    middle_mm += corner.board_mm / static_cast<double>(pose.corners.size());
    camera_sum += r.camera_px.dot(r.camera_px);
    projector_sum += r.projector_px.dot(r.projector_px);
    fit.lit_corner_count += corner.has_projector ? 1 : 0;
    fit.residuals.push_back(
        {corner.camera_px, corner.projector_px, r.camera_px, r.projector_px, corner.has_projector});
  }
  const Vec3 middle = rotation * Vec3(middle_mm[0], middle_mm[1], 0) + fit.translation_mm;
  const Vec3 axis(rotation(0, 2), rotation(1, 2), rotation(2, 2));
  fit.normal = axis.dot(middle) > 0 ? -axis : axis;
  fit.distance_mm = cv::norm(middle);
  fit.camera_rms_px = rms_of(camera_sum, fit.corner_count);
  fit.projector_rms_px = rms_of(projector_sum, fit.lit_corner_count);
  return fit;
}

void summarise(std::span<const BoardPose> poses, const BundleResult& result, GeometryFit& fit) {
  double camera_sum = 0, projector_sum = 0;
  int camera_count = 0, projector_count = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    fit.poses.push_back(pose_fit(poses[i], result.state.poses[i], result.residuals[i]));
    const PoseFit& pose = fit.poses.back();
    camera_sum += pose.camera_rms_px * pose.camera_rms_px * pose.corner_count;
    projector_sum += pose.projector_rms_px * pose.projector_rms_px * pose.lit_corner_count;
    camera_count += pose.corner_count;
    projector_count += pose.lit_corner_count;
  }
  fit.camera_rms_px = rms_of(camera_sum, camera_count);
  fit.projector_rms_px = rms_of(projector_sum, projector_count);
}

// Frees the k3 of one lens if that pays.
bool try_k3(std::span<const BoardPose> poses, std::size_t parameter, BundleOptions& options,
            BundleResult& result) {
  BundleOptions freed = options;
  freed.is_fixed[parameter] = false;
  BundleResult refined = refine_bundle(poses, result.state, freed);
  if (!(2 * (result.cost - refined.cost) > kK3Gain)) return false;
  options = freed;
  result = std::move(refined);
  return true;
}

Result<GeometryFit> fit(std::span<const BoardPose> given, ImageSize camera, ImageSize projector) {
  const Result<BundleState> start = start_state(given, camera, projector);
  if (!start) return tl::unexpected(start.error());
  BundleOptions options = without_k3();
  const int parameter_count = kSharedCount - 2 + kPoseCount * static_cast<int>(given.size());
  BundleResult result = refine_bundle(given, *start, options);
  // The corners' own standard deviations are a guess: what the residuals say replaces their scale.
  std::vector<BoardPose> poses(given.begin(), given.end());
  for (int round = 0; round < 3; ++round) {
    poses = rescaled(poses, result, parameter_count);
    result = refine_bundle(poses, result.state, options);
  }
  GeometryFit fit;
  fit.has_camera_k3 = try_k3(poses, kK3, options, result);
  fit.has_projector_k3 = try_k3(poses, kProjectorAt + kK3, options, result);
  const auto covariance = invert_information(information_of(poses, result.state, options), options);
  if (!covariance)
    return insufficient(
        "the poses leave part of the calibration undetermined; add poses with other tilts");
  fit.calibration = calibration_of(result.state.shared);
  fit.covariance = flat(*covariance);
  std::vector<double> camera_sd, projector_sd;
  for (const BoardPose& pose : poses)
    for (const BoardCorner& corner : pose.corners) {
      camera_sd.push_back(corner.camera_sd_px);
      if (corner.has_projector) projector_sd.push_back(corner.projector_sd_px);
    }
  fit.camera_noise_px = median(camera_sd);
  fit.projector_noise_px = median(projector_sd);
  fit.iterations = result.iterations;
  fit.is_converged = result.is_converged;
  summarise(poses, result, fit);
  return fit;
}

}  // namespace

double GeometryFit::sd(std::size_t parameter) const {
  return std::sqrt(covariance[parameter * kGeometryParameterCount + parameter]);
}

double GeometryFit::rotation_sd_deg() const {
  constexpr std::size_t kAt = kStereoAt;
  const double variance = sd(kAt) * sd(kAt) + sd(kAt + 1) * sd(kAt + 1) + sd(kAt + 2) * sd(kAt + 2);
  return std::sqrt(variance) * 180 / CV_PI;
}

double GeometryFit::translation_sd_mm() const {
  constexpr std::size_t kAt = kStereoAt + 3;
  return std::sqrt(sd(kAt) * sd(kAt) + sd(kAt + 1) * sd(kAt + 1) + sd(kAt + 2) * sd(kAt + 2));
}

Result<GeometryFit> fit_geometry(std::span<const BoardPose> poses, ImageSize camera,
                                 ImageSize projector) {
  if (poses.size() < kLeastPoses)
    return insufficient(std::to_string(poses.size()) + " poses; expected at least " +
                        std::to_string(kLeastPoses));
  for (const BoardPose& pose : poses)
    if (static_cast<int>(pose.corners.size()) < kLeastCorners)
      return insufficient(pose.name + ": " + std::to_string(pose.corners.size()) +
                          " corners; expected at least " + std::to_string(kLeastCorners));
  try {  // OpenCV says by exceptions what it cannot solve
    return fit(poses, camera, projector);
  } catch (const cv::Exception& error) {
    return insufficient("the poses cannot be calibrated from (" + std::string(error.err) +
                        "); add poses with other tilts");
  }
}

}  // namespace estimation
