// Where light comes from and goes to at every pixel, as scattering models want to know it.
#pragma once

#include "estimation/base/image.h"
#include "estimation/geometry/surface.h"
#include "estimation/session/manifest.h"
#include "estimation/session/pattern.h"

namespace estimation {

// Azimuths in the tangent plane, from the direction in which the projector's coordinate along
// `axis` grows fastest; [height][width], NaN where the surface is not known.
struct LightAzimuths {
  Image<float> incidence_rad;  // of the direction towards the projector
  Image<float> exit_rad;       // of the direction towards the camera
};

// Runs in the caller's oneTBB arena; same bits for any number of threads.
LightAzimuths light_azimuths(const Calibration& calibration, const CameraInfo& camera,
                             const Surface& surface, Axis axis);

}  // namespace estimation
