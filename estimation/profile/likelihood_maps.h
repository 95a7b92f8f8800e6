// From the fits of a band's sites to its maps: values, standard deviations and validity.
#pragma once

#include "estimation/models/scattering_model.h"
#include "estimation/profile/fill_sites.h"
#include "estimation/profile/likelihood_scene.h"

namespace estimation {

// How far the data scatter about the fitted curves, where the fit is valid.
struct MisfitSummary {
  double median_reduced_chi_square = 0;
  std::size_t valid_count = 0, poor_count = 0;
};

struct MapOptions {
  // Noise that was estimated from the data or assumed is known to a factor only.
  bool is_noise_measured = true;
};

// The maps on the camera grid, completed between a mosaic's sites. Standard deviations hold the
// samples' noise and, where the scene knows it, that of the surface's normals. A fit whose reduced
// chi-square is above what noise explains (five standard deviations for its degrees of freedom)
// plus a misfit of one percent of the pixel's mean (what a calibration leaves) gets the warning
// kPoorFit.
BandFit maps_of(const StripeScene& scene, const BandRadiometry& radiometry, const SiteFits& fits,
                const MapOptions& options);

MisfitSummary misfit_of(const SiteFits& fits, const BandFit& maps);

}  // namespace estimation
