// How the poses' boards stand: shared by the check and the advice. Private to this folder.
#pragma once

#include <vector>

#include "estimation/calibration/bundle.h"
#include "estimation/calibration/geometry_fit.h"

namespace estimation {

inline constexpr double kDegree = CV_PI / 180;

// Standard deviation of the normals' sideways parts in the direction where it is least, as an
// angle.
double tilt_spread_deg(const std::vector<Vec3>& normals);
std::vector<Vec3> normals_of(const GeometryFit& fit);  // [pose]
double usual_distance_mm(const GeometryFit& fit);      // mean of the poses'
SharedMatrix covariance_of(const GeometryFit& fit);

}  // namespace estimation
