// Where the stripes seem to lie is not where they lie: at a crease or near the end of the light
// more of it comes from one side, and the phase of what a pixel sees moves with it, by a quarter of
// a projector pixel on a face. Triangulated as it is, that is the largest error of the geometry.
#pragma once

#include <array>
#include <span>

#include "estimation/base/image.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/noise.h"
#include "estimation/refine/spread_field.h"
#include "estimation/session/manifest.h"

namespace estimation {

// A stripe sweep as the camera saw it.
struct StripeSweep {
  const CameraInfo& camera;
  const StripeSet& stripes;
  std::span<const ImageView<const float>> signals;  // [shift][height][width][channel] DN/us
  std::span<const MergedNoise> noise;
};

struct Position {
  Image<float> px, sd_px;  // projector coordinate along the stripes' axis
};

// The phase of the sweep's first harmonic, less what `fields` says it was moved by, as a
// coordinate: the one nearest to surface.position_px. Where the sweep has lost samples or the
// surface around is not known the coordinate and `sd_px` stay as they are.
//   fields  [band]
//   sd_px   of surface.position_px
// Runs in the caller's oneTBB arena; the same bits for any number of threads.
Position true_position(const StripeSweep& sweep, const LitSurface& surface,
                       std::span<const SpreadField> fields, ImageView<const float> sd_px);

}  // namespace estimation
