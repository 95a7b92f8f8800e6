// The joint refinement: camera, projector, how they stand, and every pose of the board, by weighted
// least squares over all corners. Private to this folder.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "estimation/calibration/board_view.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Order of the parameters that all poses share: fx fy cx cy k1 k2 p1 p2 k3 of the camera, the same
// of the projector, then rotation vector and translation (mm) from camera to projector.
inline constexpr int kSharedCount = 24;
inline constexpr int kProjectorAt = 9;
inline constexpr int kStereoAt = 18;
inline constexpr int kK3 = 8;  // within a lens
inline constexpr int kPoseCount = 6;

using SharedVector = cv::Matx<double, kSharedCount, 1>;
using SharedMatrix = cv::Matx<double, kSharedCount, kSharedCount>;
using PoseVector =
    cv::Matx<double, kPoseCount, 1>;  // rotation vector, translation mm: X_c = R X_b + t

struct BundleState {
  SharedVector shared;
  std::vector<PoseVector> poses;
};

SharedVector shared_of(const Calibration& calibration);
// Geometry alone; the rest of the calibration is empty.
Calibration calibration_of(const SharedVector& shared);

struct BundleOptions {
  std::array<bool, kSharedCount> is_fixed{};  // keeps its value
  // Residuals beyond this many standard deviations (of the corner's two coordinates together) weigh
  // less, as Huber has it.
  double robust_sd = 3;
  int max_iterations = 60;
};

// Of one corner in one device, measured minus predicted, px.
struct CornerResidual {
  Vec2 camera_px, projector_px;
  // What is left of the projector's after the part that the camera's own residual explains.
  Vec2 projector_alone_px;
};

struct BundleResult {
  BundleState state;
  std::vector<std::vector<CornerResidual>> residuals;  // [pose][corner]
  double cost = 0;                                     // half the robust sum of squares
  int iterations = 0;
  bool is_converged = false;
};

// Levenberg and Marquardt from `start`; each pose's six parameters are eliminated on the way.
// OpenCV may throw on nonsense.
BundleResult refine_bundle(std::span<const BoardPose> poses, const BundleState& start,
                           const BundleOptions& options);

// What one pose says about the shared parameters once its own place is unknown: the Fisher
// information, from the corners' standard deviations. Sums over poses. Zero for fixed parameters.
SharedMatrix shared_information(const BoardPose& pose, const SharedVector& shared,
                                const PoseVector& place, const BundleOptions& options);

// Its inverse, zero for fixed parameters; nullopt where the poses leave something undetermined.
std::optional<SharedMatrix> invert_information(const SharedMatrix& information,
                                               const BundleOptions& options);

// Camera and projector coordinates of a point of the board.
struct BoardPointImage {
  Vec2 camera_px, projector_px;
  bool is_in_front = false;  // of both
};
BoardPointImage image_board_point(const SharedVector& shared, const PoseVector& place,
                                  const Vec2& board_mm);

}  // namespace estimation
