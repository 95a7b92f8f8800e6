// The images of a stripe sweep in the order of its shifts.
#pragma once

#include <vector>

#include "estimation/base/image.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/radiometry/signal_store.h"

namespace estimation {

struct StripeSignals {
  std::vector<Image<float>> means;  // owns those of shifts seen more than once
  std::vector<ImageView<const float>> views;
};

// `patterns` must outlive what is returned.
StripeSignals signals_of(const StripeSet& stripes, const std::vector<PatternRate>& patterns);

}  // namespace estimation
