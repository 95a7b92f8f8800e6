// The joint likelihood fit of a band's whole image: a table over what the scene occupies, then all
// sites in compact tiles, so that background and invalid pixels cost nothing.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "estimation/profile/band_sites.h"
#include "estimation/profile/harmonic_table.h"
#include "estimation/profile/likelihood.h"
#include "estimation/profile/stripe_scene.h"

namespace estimation {

// What the sweep did beyond what the calibration knows (sweep_errors.h).
struct SweepCorrection {
  double blur_px2 = 0;                // variance of a residual blur; negative: sharper
  std::vector<float> offset_px = {};  // [shift] to be added to the shifts, or empty
};

// Fits of a band's sites: element i of `fit` belongs to sites[i].
struct SiteFits {
  std::vector<Site> sites;
  BatchFit fit;
};

// Immutable once built, thread-safe. The scene and the radiometry must outlive it. Everything runs
// in the caller's oneTBB arena with the same bits for any number of threads.
class BandLikelihood {
 public:
  // Fits a few thousand sites to learn the range the scene occupies.
  //   harmonic_count  of the data, used at most; 0: all samples (FitProblem)
  BandLikelihood(const StripeScene& scene, const BandRadiometry& radiometry, int harmonic_count,
                 IndirectLight indirect, const SweepCorrection& correction = {});

  const BandRadiometry& radiometry() const { return radiometry_; }
  IndirectLight indirect() const { return indirect_; }
  int harmonic_count() const { return table_ ? table_->harmonic_count() : 0; }

  // The pilot's sites and what they are.
  const SiteFits& pilot() const { return pilot_; }

  SiteFits fit(std::vector<Site> sites, const SweepCorrection& correction) const;

  // DN/us of a perfect reflector at the site.
  double full_signal_per_us(Site site) const;

 private:
  FitProblem problem() const;
  void fit_all(const SweepCorrection& correction, SiteFits& fits) const;

  const StripeScene& scene_;
  const BandRadiometry& radiometry_;
  int harmonic_limit_;
  IndirectLight indirect_;
  SiteFits pilot_;
  // The pilot's median: a first guess where light's directions need one.
  ShapePoint typical_{-0.4, 1.4};
  std::optional<HarmonicTable> table_;  // none: not a single pilot site could be fitted
};

}  // namespace estimation
