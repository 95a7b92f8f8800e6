// What the fit of a whole image is given: the signals of a stripe sweep and where every pixel
// looks.
#pragma once

#include <cstdint>
#include <span>

#include "estimation/base/image.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/noise.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Angles of each pixel's surface point, as `Directions` has them; all [height][width], or all
// empty: light comes and goes along the normal.
struct SceneDirections {
  ImageView<const float> cos_incidence, cos_exit, incidence_azimuth_rad, exit_azimuth_rad;
  bool empty() const { return cos_incidence.empty(); }
};

// What the normals' noise does to each pixel's light (TiltNoise); both [height][width], or both
// empty: the surface is known exactly.
struct SceneTilt {
  ImageView<const float> along, across;
  bool empty() const { return along.empty(); }
};

// What the fit needs to know of each camera pixel's place; all [height][width].
struct SceneGeometry {
  ImageView<const float> position_px;  // projector coordinate along the stripes' axis
  ImageView<const float> gain;         // G of design/estimation.md: light relative to the standard
  ImageView<const float> projector_distance_mm;
  ImageView<const std::uint32_t> validity;  // pixels with an error bit are passed over
  SceneDirections directions = {};
  SceneTilt tilt = {};
};

struct BandRadiometry {
  int band = 0;
  double signal_per_us = 0;         // DN/us of a perfect reflector, G = 1
  double projector_black_frac = 0;  // projector black over signal_per_us, unless subtracted already
  std::span<const MergedNoise> noise;
  // (DN/us)^2 of what all samples of a pixel err by together: a black pattern that was subtracted.
  double common_variance = 0;
};

// Everything borrowed.
struct StripeScene {
  const CameraInfo& camera;
  const StripeSet& stripes;
  // [shift of `stripes`] [height][width][channel] DN/us; one channel, or the band's of three
  std::span<const ImageView<const float>> signals;
  const SceneGeometry& geometry;
  const HarmonicTransfer& transfer;
  const ScatteringModel& model;
};

}  // namespace estimation
