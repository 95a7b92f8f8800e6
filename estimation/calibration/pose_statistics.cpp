#include "estimation/calibration/pose_statistics.h"

#include <algorithm>
#include <cmath>

namespace estimation {

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

double usual_distance_mm(const GeometryFit& fit) {
  double sum = 0;
  for (const PoseFit& pose : fit.poses) sum += pose.distance_mm;
  return sum / static_cast<double>(fit.poses.size());
}

SharedMatrix covariance_of(const GeometryFit& fit) { return SharedMatrix(fit.covariance.data()); }

}  // namespace estimation
