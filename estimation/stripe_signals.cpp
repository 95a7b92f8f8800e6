#include "estimation/stripe_signals.h"

#include <cstddef>

namespace estimation {
namespace {

// The mean of the signals that one shift was seen in more than once.
Image<float> mean_of(const std::vector<PatternRate>& patterns,
                     const std::vector<std::size_t>& sources) {
  Image<float> mean = patterns[sources[0]].rate;
  for (std::size_t i = 1; i < sources.size(); ++i)
    for (std::size_t k = 0; k < mean.samples().size(); ++k)
      mean.samples()[k] += patterns[sources[i]].rate.samples()[k];
  for (float& sample : mean.samples()) sample /= static_cast<float>(sources.size());
  return mean;
}

}  // namespace

StripeSignals signals_of(const StripeSet& stripes, const std::vector<PatternRate>& patterns) {
  StripeSignals signals;
  signals.means.reserve(stripes.sources.size());
  for (const auto& sources : stripes.sources) {
    if (sources.size() > 1) signals.means.push_back(mean_of(patterns, sources));
    signals.views.push_back(sources.size() > 1 ? signals.means.back().view()
                                               : patterns[sources[0]].rate.view());
  }
  return signals;
}

}  // namespace estimation
