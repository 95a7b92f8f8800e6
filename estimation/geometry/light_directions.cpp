#include "estimation/geometry/light_directions.h"

#include <oneapi/tbb/parallel_for.h>

#include <cmath>
#include <limits>

#include "estimation/geometry/triangulation.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col) {
  Vec3 vector;
  for (int i = 0; i < 3; ++i)
    vector[i] = static_cast<double>(image[static_cast<std::size_t>(i)].at(row, col));
  return vector;
}

}  // namespace

LightAzimuths light_azimuths(const Calibration& calibration, const CameraInfo& camera,
                             const Surface& surface, Axis axis) {
  const Image<float> unknown(camera.height_px, camera.width_px, 1,
                             std::numeric_limits<float>::quiet_NaN());
  LightAzimuths azimuths{unknown, unknown};
  const Stereo stereo(calibration, camera);
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col) {
      if ((surface.validity.at(row, col) & kValidityErrors) != 0) continue;
      const Vec3 point_mm = vector_at(surface.position_mm, row, col);
      const Vec3 normal = vector_at(surface.normal, row, col);
      const auto lit = stereo.project(point_mm);
      if (!lit) continue;
      const Vec3& gradient =
          axis == Axis::kColumn ? lit->column_gradient_px_per_mm : lit->row_gradient_px_per_mm;
      const Vec3 along = gradient - normal.dot(gradient) * normal;
      const Vec3 across = normal.cross(along);
      const auto azimuth_rad = [&](const Vec3& direction) {
        return static_cast<float>(std::atan2(direction.dot(across), direction.dot(along)));
      };
      azimuths.incidence_rad.at(row, col) = azimuth_rad(stereo.projector_centre_mm() - point_mm);
      azimuths.exit_rad.at(row, col) = azimuth_rad(-point_mm);
    }
  });
  return azimuths;
}

}  // namespace estimation
