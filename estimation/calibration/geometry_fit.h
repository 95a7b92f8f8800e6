// Camera and projector from a board in several poses: Zhang's method with the projector as an
// inverse camera, then one joint refinement with the bound on what it can know.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "estimation/calibration/board_view.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Order of the covariance's parameters: fx fy cx cy k1 k2 p1 p2 k3 of the camera, the same of the
// projector, then rotation vector (rad) and translation (mm) from camera to projector.
inline constexpr std::size_t kGeometryParameterCount = 24;
extern const std::array<const char*, kGeometryParameterCount> kGeometryParameterNames;

// A pose as fitted. X_c = R X_b + t.
struct PoseFit {
  std::string name;
  Vec3 rotation_rad;  // vector
  Vec3 translation_mm;
  Vec3 normal;             // of the board, unit, towards the camera
  double distance_mm = 0;  // of the board's middle from the camera
  int corner_count = 0, lit_corner_count = 0;
  double camera_rms_px = 0;     // of the distance from corner to prediction
  double projector_rms_px = 0;  // 0 without lit corners
  struct Residual {
    Vec2 camera_px, projector_px;              // measured, on the sensor and the projector
    Vec2 camera_error_px, projector_error_px;  // measured minus predicted
    bool has_projector = false;
  };
  std::vector<Residual> residuals;  // [corner]
};

struct GeometryFit {
  Calibration calibration;  // its geometry alone
  std::vector<PoseFit> poses;
  double camera_rms_px = 0, projector_rms_px = 0;  // of all poses
  // Standard deviation of one coordinate, from the residuals: the noise that the bound assumes.
  double camera_noise_px = 0, projector_noise_px = 0;
  // [24][24] row-major; zero for parameters that were not fitted. The Cramer-Rao bound at the
  // noise above.
  std::vector<double> covariance;
  bool has_camera_k3 = false, has_projector_k3 = false;  // fitted because the data ask for it
  int iterations = 0;
  bool is_converged = false;

  double sd(std::size_t parameter) const;
  double rotation_sd_deg() const;    // of the rotation from camera to projector, about any axis
  double translation_sd_mm() const;  // of the projector's place, along any axis
};

struct ImageSize {
  int width_px = 0, height_px = 0;
};

// `camera` is the size of the sensor that the corners' pixels refer to (only a start for the
// principal point). Poses with fewer than six corners are an error. Needs three poses with six
// lit corners or more. k3 is fitted where it improves the fit significantly, and is 0 otherwise.
// Errors: kInsufficient, with what is missing; the noise of the corners must be positive.
Result<GeometryFit> fit_geometry(std::span<const BoardPose> poses, ImageSize camera,
                                 ImageSize projector);

}  // namespace estimation
