#include "estimation/capture_order.h"

#include <algorithm>
#include <map>
#include <numeric>

namespace estimation {
namespace {

// [pattern of `signals`] ns by the camera's clock, or the pattern's place.
std::vector<double> capture_times(const Manifest& manifest, const SignalStore::Signals& signals) {
  std::map<int, std::vector<double>> stamps_ns;
  bool is_stamped = true;
  for (const FrameRecord& frame : manifest.frames) {
    is_stamped = is_stamped && frame.camera_timestamp_ns.has_value();
    stamps_ns[frame.pattern].push_back(
        static_cast<double>(frame.camera_timestamp_ns.value_or(0) -
                            manifest.frames.front().camera_timestamp_ns.value_or(0)));
  }
  std::vector<double> times;
  for (const PatternRate& pattern : signals.patterns) {
    const std::vector<double>& own = stamps_ns[pattern.pattern->index];
    const double sum = std::accumulate(own.begin(), own.end(), 0.0);
    times.push_back(is_stamped ? sum / static_cast<double>(own.size())
                               : static_cast<double>(pattern.pattern - manifest.patterns.data()));
  }
  return times;
}

}  // namespace

std::vector<double> capture_order(const Manifest& manifest, const StripeSet& stripes,
                                  const SignalStore::Signals& signals) {
  const std::vector<double> times = capture_times(manifest, signals);
  std::vector<double> order;
  for (const auto& sources : stripes.sources) order.push_back(times[sources.front()]);
  const auto [first, last] = std::minmax_element(order.begin(), order.end());
  const double begin = *first, duration = *last - *first;
  for (double& when : order) when = duration > 0 ? (when - begin) / duration - 0.5 : 0;
  return order;
}

}  // namespace estimation
