// Two errors that all pixels of a sweep share, told by their residuals: a blur that the calibration
// does not know, and a drift of subject or projector while the shifts went by
// (design/estimation.md, section 4).
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "estimation/profile/likelihood_scene.h"

namespace estimation {

struct SweepErrors {
  // Variance of a Gaussian, projector px^2, by which the stripes are blurred beyond
  // calibration.stripe_transfer; negative if they are sharper.
  double blur_px2 = 0, blur_px2_sd = 0;
  // What is to be added to the shifts from the sweep's begin to its end, projector px.
  double drift_px = 0, drift_sd_px = 0;
  // Median reduced chi-square of the sites used, without and with both taken into account.
  double chi_square_before = 1, chi_square_after = 1;
  std::size_t site_count = 0;
  bool has_perfect_optics = false;  // by the calibration: nothing can be sharper
};

// Gauss-Newton over the two, each site's own unknowns projected out, from the pilot sites of all
// bands away from discontinuities. The standard deviations hold the scatter between sixteen parts
// of the image, so that a model that fits one material and not the other does not pass for certain.
//   capture_order  [shift] when it was seen, -0.5 to 0.5 over the sweep
//   returns        nullopt with too few sites to tell
// Runs in the caller's oneTBB arena; same bits for any number of threads.
std::optional<SweepErrors> estimate_sweep_errors(const StripeScene& scene,
                                                 std::span<const BandLikelihood> bands,
                                                 std::span<const double> capture_order);

struct EarnedCorrection {
  bool has_blur = false, has_drift = false;
  bool any() const { return has_blur || has_drift; }
};

// Which of the two are five standard deviations and more than a rig's calibration leaves (0.2 px of
// blur, 0.05 px of drift) away from nothing.
EarnedCorrection significant_errors(const SweepErrors& errors);

// The same where the data then look as the model says, to 5% of the reduced chi-square: a wrong
// model shows as blur, too, but some of its misfit stays.
EarnedCorrection earned_correction(const SweepErrors& errors);

SweepCorrection correction_of(const SweepErrors& errors, EarnedCorrection earned,
                              std::span<const double> capture_order);

// For people: what was found, and whether it agrees with the calibration.
std::string describe(const SweepErrors& errors, EarnedCorrection earned, bool is_corrected);

}  // namespace estimation
