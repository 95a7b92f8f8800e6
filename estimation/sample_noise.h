// The noise of a session's merged samples: by the camera's own numbers, told by the stripes, or
// assumed.
#pragma once

#include <optional>
#include <vector>

#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct SampleNoise {
  std::vector<MergedNoise> merged;
  bool is_measured = false;  // by the camera's own numbers; else told by the data, or assumed
};

// Of the stripes' samples, or of the first pattern's where there are none; black patterns that were
// subtracted included.
SampleNoise sample_noise(const CameraInfo& camera, const CameraBlack& black, double saturation_dn,
                         const SignalStore::Signals& signals,
                         const std::optional<StripeSet>& stripes);

// (DN/us)^2 of the mean of the black patterns that were subtracted; 0 if none was.
double background_variance(const CameraInfo& camera, const CameraBlack& black, double saturation_dn,
                           const SignalStore::Signals& signals, const SampleNoise& noise);

}  // namespace estimation
