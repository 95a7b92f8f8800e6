// A surface as the projector lights it: what the fits need to know of each pixel's place, and each
// band's radiometry.
#pragma once

#include <cstdint>

#include "estimation/base/image.h"
#include "estimation/geometry/light_directions.h"
#include "estimation/material_maps.h"
#include "estimation/profile/stripe_scene.h"

namespace estimation {

// Lit along one axis of the projector. Borrows the input's correspondence and the surface.
class LitGeometry {
 public:
  // Directions are filled for models that depend on them, what tilts do to the light for all
  // (`method` likelihood only). Pixels that
  // have no place on the axis or no light get kNoCorrespondence, where they had no error yet.
  LitGeometry(const MaterialInput& input, const Surface& surface, Axis axis);
  LitGeometry(const LitGeometry&) = delete;
  LitGeometry& operator=(const LitGeometry&) = delete;

  Axis axis() const { return axis_; }
  const SceneGeometry& geometry() const { return geometry_; }
  const Image<float>& position_px() const { return position_px_; }  // in the projector
  const Image<float>& pitch_mm() const { return pitch_mm_; }        // of a projector pixel

 private:
  void fill_tilt(const MaterialInput& input, const Surface& surface);

  Axis axis_;
  const Image<float>& position_px_;
  const Image<float>& pitch_mm_;
  Image<float> gain_;
  Image<std::uint32_t> validity_;
  LightAzimuths azimuths_;  // empty for models without directions
  Image<float> tilt_along_, tilt_across_;
  SceneGeometry geometry_;
};

BandRadiometry radiometry_of(const MaterialInput& input, int band);

}  // namespace estimation
