// The paper's estimate for a whole image, one band: table over what the scene holds, all sites.
#pragma once

#include <span>

#include "estimation/base/image.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/fill_sites.h"
#include "estimation/profile/profile_point.h"
#include "estimation/profile/profile_table.h"
#include "estimation/profile/stripe_scene.h"

namespace estimation {

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

// What was found at a site.
struct SiteMaterial {
  int row = 0, col = 0;
  double diffuse_reflectance = 0, translucency_px = 0, indirect = 0;
  double phase_px = 0;  // to be added to the site's projector coordinate
};

// The profile of a site: its samples as the fit saw them, and the curve of what it found there,
// optics and light's directions included, four points a projector pixel. l_d in mm is left to the
// caller, who knows the pitch.
//   blur_px2  as SiteFactors takes it
ProfileBand profile_of_site(const StripeScene& scene, const BandRadiometry& radiometry,
                            const SiteMaterial& found, double blur_px2);

// R_d alone from the fully lit image, indirect light included (which a warning says): all there is
// without stripes.
BandFit reflectance_of_band(const CameraInfo& camera, const BandRadiometry& radiometry,
                            ImageView<const float> fully_lit, const SceneGeometry& geometry);

}  // namespace estimation
