#include "estimation/stripe_signals.h"

#include <cstddef>
#include <variant>

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

std::optional<StripeSet> placed_stripes(const std::vector<PatternRate>& patterns,
                                        const Correspondence& correspondence) {
  static const PatternKind kNone = Black{};
  std::vector<const PatternKind*> kinds;
  for (const PatternRate& pattern : patterns) {
    const auto* stripes = std::get_if<Stripes>(&pattern.pattern->kind);
    const bool is_usable =
        stripes == nullptr ||
        !(stripes->axis == Axis::kColumn ? correspondence.column_px : correspondence.row_px)
             .empty();
    kinds.push_back(is_usable ? &pattern.pattern->kind : &kNone);
  }
  return choose_stripe_set(kinds);
}

StripeSet each_seen(const StripeSet& stripes) {
  StripeSet all{.axis = stripes.axis, .shape = stripes.shape};
  for (std::size_t i = 0; i < stripes.shifts_px.size(); ++i)
    for (const std::size_t source : stripes.sources[i]) {
      all.shifts_px.push_back(stripes.shifts_px[i]);
      all.sources.push_back({source});
    }
  return all;
}

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
