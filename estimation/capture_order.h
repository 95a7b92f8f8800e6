// When the patterns of a sweep were seen, which a drift of the light follows.
#pragma once

#include <vector>

#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/manifest.h"

namespace estimation {

// [shift of `stripes`] -0.5 to 0.5 from the first pattern of the sweep to the last: by the camera's
// clock where it stamped all frames, else by their place among the manifest's patterns.
std::vector<double> capture_order(const Manifest& manifest, const StripeSet& stripes,
                                  const SignalStore::Signals& signals);

}  // namespace estimation
