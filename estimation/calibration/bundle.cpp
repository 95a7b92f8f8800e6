#include "estimation/calibration/bundle.h"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "estimation/base/check.h"

namespace estimation {
namespace {

constexpr int kAllCount = kSharedCount + kPoseCount;
using PoseMatrix = cv::Matx<double, kPoseCount, kPoseCount>;
using MixedMatrix = cv::Matx<double, kSharedCount, kPoseCount>;
using Row = std::array<double, kAllCount>;  // a residual's derivatives: shared, then the pose's

double& entry(Row& row, int i) { return row[static_cast<std::size_t>(i)]; }
double entry(const Row& row, int i) { return row[static_cast<std::size_t>(i)]; }

constexpr double kRelativeCostTolerance = 1e-12;
constexpr double kFirstDamping = 1e-4;
constexpr double kLargestDamping = 1e12;

Vec3 part(const double* values) { return {values[0], values[1], values[2]}; }

// Pixels of the points and their derivatives by [rotation 3, translation 3, f 2, c 2, distortion
// 5].
struct Imaged {
  std::vector<cv::Point2d> pixels;
  cv::Mat1d derivatives;  // [2 N][15]
};

Imaged image_points(const std::vector<cv::Point3d>& points, const Vec3& rotation,
                    const Vec3& translation, const double* lens) {
  const cv::Matx33d K(lens[0], 0, lens[2], 0, lens[1], lens[3], 0, 0, 1);
  const cv::Matx<double, 5, 1> distortion(lens + 4);
  Imaged imaged;
  cv::Mat derivatives;
  cv::projectPoints(points, rotation, translation, K, distortion, imaged.pixels, derivatives);
  imaged.derivatives = derivatives;
  return imaged;
}

// The board seen from the projector: its place there, and that place's derivatives.
struct Composed {
  Vec3 rotation, translation;
  std::array<cv::Matx33d, 2> rotation_by_rotation;     // by the pose's, by the stereo's
  std::array<cv::Matx33d, 2> translation_by_rotation;  //
  std::array<cv::Matx33d, 2> translation_by_translation;
};

Composed compose(const PoseVector& place, const SharedVector& shared) {
  Composed c;
  cv::Mat r, t, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2;
  cv::composeRT(part(place.val), part(place.val + 3), part(shared.val + kStereoAt),
                part(shared.val + kStereoAt + 3), r, t, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2,
                t_t2);
  c.rotation = Vec3(r);
  c.translation = Vec3(t);
  c.rotation_by_rotation = {cv::Matx33d(r_r1), cv::Matx33d(r_r2)};
  c.translation_by_rotation = {cv::Matx33d(t_r1), cv::Matx33d(t_r2)};
  c.translation_by_translation = {cv::Matx33d(t_t1), cv::Matx33d(t_t2)};
  return c;
}

// The camera's derivatives sorted into a row over all parameters.
Row camera_row(const cv::Mat1d& derivatives, int at) {
  Row row{};
  const double* d = derivatives[at];
  for (int i = 0; i < 6; ++i) entry(row, kSharedCount + i) = d[i];
  for (int i = 0; i < 9; ++i) entry(row, i) = d[6 + i];
  return row;
}

Row projector_row(const cv::Mat1d& derivatives, int at, const Composed& composed) {
  Row row{};
  const double* d = derivatives[at];
  const cv::Matx13d by_rotation(d), by_translation(d + 3);
  const auto by_place = [&](std::size_t which) {
    return std::pair{by_rotation * composed.rotation_by_rotation[which] +
                         by_translation * composed.translation_by_rotation[which],
                     by_translation * composed.translation_by_translation[which]};
  };
  const auto [pose_r, pose_t] = by_place(0);
  const auto [stereo_r, stereo_t] = by_place(1);
  for (int i = 0; i < 3; ++i) {
    entry(row, kSharedCount + i) = pose_r(i);
    entry(row, kSharedCount + 3 + i) = pose_t(i);
    entry(row, kStereoAt + i) = stereo_r(i);
    entry(row, kStereoAt + 3 + i) = stereo_t(i);
  }
  for (int i = 0; i < 9; ++i) entry(row, kProjectorAt + i) = d[6 + i];
  return row;
}

// The normal equations of one pose.
struct PoseEquations {
  SharedMatrix shared = SharedMatrix::zeros();
  MixedMatrix mixed = MixedMatrix::zeros();
  PoseMatrix own = PoseMatrix::zeros();
  SharedVector shared_gradient = SharedVector::zeros();
  PoseVector own_gradient = PoseVector::zeros();
  double cost = 0;
  std::vector<CornerResidual> residuals;
};

// Adds a corner's two residuals of one device with their common weight.
void add_rows(const std::array<Row, 2>& rows, const Vec2& residual, double sd_px, double robust_sd,
              PoseEquations& e) {
  const double norm = cv::norm(residual) / sd_px;
  const bool is_far = norm > robust_sd;
  e.cost += is_far ? robust_sd * (norm - robust_sd / 2) : norm * norm / 2;
  const double weight = (is_far ? robust_sd / norm : 1) / (sd_px * sd_px);
  for (std::size_t k = 0; k < 2; ++k) {
    const Row& row = rows[k];
    const double error = residual[static_cast<int>(k)] * weight;
    for (int i = 0; i < kSharedCount; ++i) {
      const double value = entry(row, i);
      if (value == 0) continue;
      e.shared_gradient(i) += value * error;
      for (int j = 0; j < kSharedCount; ++j) e.shared(i, j) += weight * value * entry(row, j);
      for (int j = 0; j < kPoseCount; ++j)
        e.mixed(i, j) += weight * value * entry(row, kSharedCount + j);
    }
    for (int i = 0; i < kPoseCount; ++i) {
      const double value = entry(row, kSharedCount + i);
      e.own_gradient(i) += value * error;
      for (int j = 0; j < kPoseCount; ++j)
        e.own(i, j) += weight * value * entry(row, kSharedCount + j);
    }
  }
}

void fix(const BundleOptions& options, PoseEquations& e) {
  for (int i = 0; i < kSharedCount; ++i) {
    if (!options.is_fixed[static_cast<std::size_t>(i)]) continue;
    e.shared_gradient(i) = 0;
    for (int j = 0; j < kSharedCount; ++j) e.shared(i, j) = e.shared(j, i) = 0;
    for (int j = 0; j < kPoseCount; ++j) e.mixed(i, j) = 0;
  }
}

PoseEquations equations_of(const BoardPose& pose, const SharedVector& shared,
                           const PoseVector& place, const BundleOptions& options) {
  std::vector<cv::Point3d> points;
  for (const BoardCorner& corner : pose.corners)
    points.emplace_back(corner.board_mm[0], corner.board_mm[1], 0);
  const Composed composed = compose(place, shared);
  const Imaged camera = image_points(points, part(place.val), part(place.val + 3), shared.val);
  const Imaged projector =
      image_points(points, composed.rotation, composed.translation, shared.val + kProjectorAt);
  PoseEquations e;
  for (std::size_t i = 0; i < pose.corners.size(); ++i) {
    const BoardCorner& corner = pose.corners[i];
    const int at = 2 * static_cast<int>(i);
    const Vec2 seen = Vec2(camera.pixels[i].x, camera.pixels[i].y) - corner.camera_px;
    const std::array rows{camera_row(camera.derivatives, at),
                          camera_row(camera.derivatives, at + 1)};
    add_rows(rows, seen, corner.camera_sd_px, options.robust_sd, e);
    CornerResidual residual{-seen, {}, {}};
    if (corner.has_projector) {
      const Mat2& by_camera = corner.projector_by_camera;
      const Vec2 lit = Vec2(projector.pixels[i].x, projector.pixels[i].y) - corner.projector_px;
      const Vec2 alone = lit - by_camera * seen;
      std::array lit_rows{projector_row(projector.derivatives, at, composed),
                          projector_row(projector.derivatives, at + 1, composed)};
      for (std::size_t k = 0; k < 2; ++k)
        for (std::size_t j = 0; j < kAllCount; ++j)
          lit_rows[k][j] -= by_camera(static_cast<int>(k), 0) * rows[0][j] +
                            by_camera(static_cast<int>(k), 1) * rows[1][j];
      add_rows(lit_rows, alone, corner.projector_sd_px, options.robust_sd, e);
      residual.projector_px = -lit;
      residual.projector_alone_px = -alone;
    }
    e.residuals.push_back(residual);
  }
  fix(options, e);
  return e;
}

std::vector<PoseEquations> all_equations(std::span<const BoardPose> poses, const BundleState& state,
                                         const BundleOptions& options) {
  std::vector<PoseEquations> all;
  all.reserve(poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i)
    all.push_back(equations_of(poses[i], state.shared, state.poses[i], options));
  return all;
}

double cost_of(const std::vector<PoseEquations>& all) {
  double cost = 0;
  for (const PoseEquations& e : all) cost += e.cost;
  return cost;
}

// Inverse of a symmetric matrix with positive diagonal, scaled to a unit diagonal first because
// focal lengths and distortions are orders apart. Rows without information (zero) stay zero.
template <int n>
std::optional<cv::Matx<double, n, n>> invert(const cv::Matx<double, n, n>& matrix) {
  cv::Matx<double, n, 1> scale;
  cv::Matx<double, n, n> scaled;
  for (int i = 0; i < n; ++i) scale(i) = matrix(i, i) > 0 ? 1 / std::sqrt(matrix(i, i)) : 0;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) scaled(i, j) = matrix(i, j) * scale(i) * scale(j);
  for (int i = 0; i < n; ++i)
    if (scale(i) == 0) scaled(i, i) = 1;
  bool is_definite = false;
  const cv::Matx<double, n, n> inverse = scaled.inv(cv::DECOMP_CHOLESKY, &is_definite);
  if (!is_definite) return std::nullopt;
  cv::Matx<double, n, n> result;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      result(i, j) = inverse(i, j) * scale(i) * scale(j);
      if (!std::isfinite(result(i, j))) return std::nullopt;
    }
  return result;
}

template <int n>
cv::Matx<double, n, n> damped(cv::Matx<double, n, n> matrix, double damping) {
  for (int i = 0; i < n; ++i) matrix(i, i) *= 1 + damping;
  return matrix;
}

// The step that the normal equations ask for; nullopt if they are singular at this damping.
std::optional<BundleState> step_from(const BundleState& from, const std::vector<PoseEquations>& all,
                                     double damping) {
  SharedMatrix reduced = SharedMatrix::zeros();
  SharedVector gradient = SharedVector::zeros();
  std::vector<PoseMatrix> inverses;
  for (const PoseEquations& e : all) {
    const auto inverse = invert(damped(e.own, damping));
    if (!inverse) return std::nullopt;
    inverses.push_back(*inverse);
    const MixedMatrix eliminated = e.mixed * *inverse;
    reduced += damped(e.shared, damping) - eliminated * e.mixed.t();
    gradient += e.shared_gradient - eliminated * e.own_gradient;
  }
  const auto inverse = invert(reduced);
  if (!inverse) return std::nullopt;
  const SharedVector step = *inverse * gradient;
  BundleState next = from;
  next.shared -= step;
  for (std::size_t i = 0; i < all.size(); ++i)
    next.poses[i] -= inverses[i] * (all[i].own_gradient - all[i].mixed.t() * step);
  return next;
}

}  // namespace

SharedVector shared_of(const Calibration& calibration) {
  SharedVector shared;
  const auto put = [&](const Lens& lens, int at) {
    const double values[4] = {lens.K(0, 0), lens.K(1, 1), lens.K(0, 2), lens.K(1, 2)};
    for (int i = 0; i < 4; ++i) shared(at + i) = values[i];
    for (int i = 0; i < 5; ++i) shared(at + 4 + i) = lens.distortion[static_cast<std::size_t>(i)];
  };
  put(calibration.camera, 0);
  put(calibration.projector, kProjectorAt);
  Vec3 rotation;
  cv::Rodrigues(calibration.projector_from_camera, rotation);
  for (int i = 0; i < 3; ++i) {
    shared(kStereoAt + i) = rotation[i];
    shared(kStereoAt + 3 + i) = calibration.projector_from_camera_mm[i];
  }
  return shared;
}

Calibration calibration_of(const SharedVector& shared) {
  const auto lens_at = [&](int at) {
    Lens lens;
    lens.K = Mat3(shared(at), 0, shared(at + 2), 0, shared(at + 1), shared(at + 3), 0, 0, 1);
    for (int i = 0; i < 5; ++i) lens.distortion[static_cast<std::size_t>(i)] = shared(at + 4 + i);
    return lens;
  };
  Calibration calibration;
  calibration.camera = lens_at(0);
  calibration.projector = lens_at(kProjectorAt);
  cv::Rodrigues(part(shared.val + kStereoAt), calibration.projector_from_camera);
  calibration.projector_from_camera_mm = part(shared.val + kStereoAt + 3);
  return calibration;
}

BundleResult refine_bundle(std::span<const BoardPose> poses, const BundleState& start,
                           const BundleOptions& options) {
  check(poses.size() == start.poses.size(), "a start for each pose");
  BundleResult result{.state = start, .residuals = {}};
  std::vector<PoseEquations> all = all_equations(poses, start, options);
  result.cost = cost_of(all);
  double damping = kFirstDamping;
  while (result.iterations < options.max_iterations && damping < kLargestDamping) {
    ++result.iterations;
    const auto next = step_from(result.state, all, damping);
    if (next) {
      std::vector<PoseEquations> equations = all_equations(poses, *next, options);
      const double cost = cost_of(equations);
      if (cost <= result.cost) {
        result.is_converged = result.cost - cost <= kRelativeCostTolerance * (1 + cost);
        result.state = *next;
        result.cost = cost;
        all = std::move(equations);
        damping /= 10;
        if (result.is_converged) break;
        continue;
      }
    }
    damping *= 10;
  }
  for (PoseEquations& e : all) result.residuals.push_back(std::move(e.residuals));
  return result;
}

SharedMatrix shared_information(const BoardPose& pose, const SharedVector& shared,
                                const PoseVector& place, const BundleOptions& options) {
  BundleOptions exact = options;
  exact.robust_sd = std::numeric_limits<double>::infinity();
  const PoseEquations e = equations_of(pose, shared, place, exact);
  const auto inverse = invert(e.own);
  if (!inverse) return SharedMatrix::zeros();  // too few corners to place the board
  return e.shared - e.mixed * *inverse * e.mixed.t();
}

std::optional<SharedMatrix> invert_information(const SharedMatrix& information,
                                               const BundleOptions& options) {
  for (int i = 0; i < kSharedCount; ++i)
    if (!options.is_fixed[static_cast<std::size_t>(i)] && !(information(i, i) > 0))
      return std::nullopt;
  return invert(information);
}

BoardPointImage image_board_point(const SharedVector& shared, const PoseVector& place,
                                  const Vec2& board_mm) {
  const Calibration calibration = calibration_of(shared);
  cv::Matx33d rotation;
  cv::Rodrigues(part(place.val), rotation);
  const Vec3 seen = rotation * Vec3(board_mm[0], board_mm[1], 0) + part(place.val + 3);
  const Vec3 lit = calibration.projector_from_camera * seen + calibration.projector_from_camera_mm;
  if (!(seen[2] > 0) || !(lit[2] > 0)) return {};
  return {LensModel(calibration.camera).image({seen[0] / seen[2], seen[1] / seen[2]}).pixel,
          LensModel(calibration.projector).image({lit[0] / lit[2], lit[1] / lit[2]}).pixel, true};
}

}  // namespace estimation
