// The sweep of stripes among the patterns, and its images in the order of its shifts.
#pragma once

#include <optional>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/signal_store.h"

namespace estimation {

// The largest sweep along an axis that has a correspondence: without one its stripes have no known
// phase. Nullopt: there is none with enough shifts.
std::optional<StripeSet> placed_stripes(const std::vector<PatternRate>& patterns,
                                        const Correspondence& correspondence);

// Every image of a sweep as a sample of its own, also where a shift was seen twice.
StripeSet each_seen(const StripeSet& stripes);

struct StripeSignals {
  std::vector<Image<float>> means;  // owns those of shifts seen more than once
  std::vector<ImageView<const float>> views;
};

// `patterns` must outlive what is returned.
StripeSignals signals_of(const StripeSet& stripes, const std::vector<PatternRate>& patterns);

}  // namespace estimation
