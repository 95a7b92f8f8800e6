#include "rig/clock.h"

#include <algorithm>
#include <cmath>

#include "estimation/base/check.h"

namespace rig {
namespace {

template <typename Duration>
double to_ns(Duration duration) {
  return static_cast<double>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(duration).count());
}

// Device clocks tick in microseconds at best, and a weight must not be infinite.
constexpr std::chrono::nanoseconds kLeastUncertainty{500};
// Crystals are good to 100 ppm.
constexpr double kDriftSpread = 100e-6;

}  // namespace

template <typename DeviceClock>
void ClockMap<DeviceClock>::add(typename DeviceClock::time_point device, HostTime host,
                                std::chrono::nanoseconds uncertainty) {
  samples_.push_back({device, host, std::max(uncertainty, kLeastUncertainty)});
  if (samples_.size() > kSampleLimit) samples_.pop_front();
  fit();
}

template <typename DeviceClock>
std::chrono::nanoseconds ClockMap<DeviceClock>::best_uncertainty() const {
  auto best = std::chrono::nanoseconds::max();
  for (const Sample& sample : samples_) best = std::min(best, sample.uncertainty);
  return best;
}

template <typename DeviceClock>
void ClockMap<DeviceClock>::fit() {
  const Sample& first = samples_.front();
  const auto best = best_uncertainty();
  const auto weight_of = [best](const Sample& sample) {
    const double ratio = to_ns(best) / to_ns(sample.uncertainty);
    return ratio * ratio;
  };
  double sum_weight = 0;
  mean_device_ns_ = mean_host_ns_ = 0;
  for (const Sample& sample : samples_) {
    const double weight = weight_of(sample);
    sum_weight += weight;
    mean_device_ns_ += weight * to_ns(sample.device - first.device);
    mean_host_ns_ += weight * to_ns(sample.host - first.host);
  }
  mean_device_ns_ /= sum_weight;
  mean_host_ns_ /= sum_weight;
  double sum_xx = 0;
  double sum_xy = 0;
  for (const Sample& sample : samples_) {
    const double x = to_ns(sample.device - first.device) - mean_device_ns_;
    const double y = to_ns(sample.host - first.host) - mean_host_ns_;
    sum_xx += weight_of(sample) * x * x;
    sum_xy += weight_of(sample) * x * (y - x);
  }
  // Least squares with a normal prior on the drift.
  const double prior = to_ns(best) / kDriftSpread;
  drift_ = sum_xy / (sum_xx + prior * prior);
}

template <typename DeviceClock>
HostTime ClockMap<DeviceClock>::to_host(typename DeviceClock::time_point device) const {
  estimation::check(is_ready(), "clock map used before its first sample");
  const double x = to_ns(device - samples_.front().device) - mean_device_ns_;
  // A device may say anything: what lies beyond a century is as good as anything else out there,
  // and a sum that no time point holds is not defined.
  constexpr double kFarthest_ns = 4e18;
  const double host_ns = std::clamp(mean_host_ns_ + x + drift_ * x, -kFarthest_ns, kFarthest_ns);
  return samples_.front().host + std::chrono::duration_cast<HostClock::duration>(
                                     std::chrono::nanoseconds(std::llround(host_ns)));
}

template class ClockMap<BoxClock>;
template class ClockMap<CameraClock>;

}  // namespace rig
