// The paper's estimate for a whole image, one band: table over what the scene holds, all sites.
#pragma once

#include <cstdint>
#include <span>

#include "estimation/base/image.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/fill_sites.h"
#include "estimation/profile/profile_point.h"
#include "estimation/profile/profile_table.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/noise.h"
#include "estimation/session/manifest.h"

namespace estimation {

// What the fit needs to know of each camera pixel's place; all [height][width].
struct SceneGeometry {
  ImageView<const float> position_px;  // projector coordinate along the stripes' axis
  ImageView<const float> gain;         // G of design/estimation.md: light relative to the standard
  ImageView<const float> projector_distance_mm;
  ImageView<const std::uint32_t> validity;  // pixels with an error bit are passed over
};

struct BandRadiometry {
  int band = 0;
  double signal_per_us = 0;         // DN/us of a perfect reflector, G = 1
  double projector_black_frac = 0;  // projector black over signal_per_us, unless subtracted already
  std::span<const MergedNoise> noise;
};

// Fits every site of the band. Both calls run in the caller's oneTBB arena and give the same bits
// for any number of threads.
//   signals  [shift of `stripes`] [height][width][channel] DN/us; one channel, or the band's of
//   three wide     a table of TableRange{}: finds the range the scene occupies, for a finer table
//   of its
//            own, and fits the few pixels outside of that
BandFit fit_band(const CameraInfo& camera, const BandRadiometry& radiometry,
                 const StripeSet& stripes, std::span<const ImageView<const float>> signals,
                 const SceneGeometry& geometry, const HarmonicTransfer& transfer,
                 const ScatteringModel& model, const ProfileTable& wide);

// What fit_band found at a site.
struct SiteMaterial {
  int row = 0, col = 0;
  double diffuse_reflectance = 0, translucency_px = 0, indirect = 0;
};

// The profile of a site: its samples as the fit saw them, and the curve of what it found there,
// four points a projector pixel. l_d in mm is left to the caller, who knows the pitch.
ProfileBand profile_of_site(const CameraInfo& camera, const BandRadiometry& radiometry,
                            const StripeSet& stripes,
                            std::span<const ImageView<const float>> signals,
                            const SceneGeometry& geometry, const HarmonicTransfer& transfer,
                            const ScatteringModel& model, const SiteMaterial& found);

// R_d alone from the fully lit image, indirect light included (which a warning says): all there is
// without stripes.
BandFit reflectance_of_band(const CameraInfo& camera, const BandRadiometry& radiometry,
                            ImageView<const float> fully_lit, const SceneGeometry& geometry);

}  // namespace estimation
