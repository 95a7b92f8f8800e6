// What an uncertain calibration does to a triangulated depth. Private to this folder.
#pragma once

#include "estimation/calibration/bundle.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Mean over points of the camera's picture at distances `nearest_mm` .. `farthest_mm` of a a^T, a
// the derivative of the depth by the shared parameters, camera and projector px given: the trace of
// its product with a covariance is the depth's mean variance, mm^2. Zero if nothing is lit.
SharedMatrix depth_sensitivity(const Calibration& calibration, const CameraInfo& camera,
                               const ProjectorInfo& projector, double nearest_mm,
                               double farthest_mm);

// sqrt(trace(sensitivity covariance)), mm.
double depth_sd_mm(const SharedMatrix& sensitivity, const SharedMatrix& covariance);

}  // namespace estimation
