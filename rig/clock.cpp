#include "rig/clock.h"

#include <cmath>

#include "estimation/base/check.h"

namespace rig {
namespace {

template <typename Duration>
double to_ns(Duration duration) {
  return static_cast<double>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(duration).count());
}

}  // namespace

template <typename DeviceClock>
void ClockMap<DeviceClock>::add(typename DeviceClock::time_point device, HostTime host,
                                std::chrono::nanoseconds uncertainty) {
  if (uncertainty < best_uncertainty_) best_uncertainty_ = uncertainty;
  if (!samples_.empty() && uncertainty > 2 * best_uncertainty_) return;
  samples_.push_back({device, host});
  if (samples_.size() > kSampleLimit) samples_.pop_front();
  fit();
}

template <typename DeviceClock>
void ClockMap<DeviceClock>::fit() {
  const auto& first = samples_.front();
  const double count = static_cast<double>(samples_.size());
  mean_device_ns_ = mean_host_ns_ = 0;
  for (const Sample& sample : samples_) {
    mean_device_ns_ += to_ns(sample.device - first.device) / count;
    mean_host_ns_ += to_ns(sample.host - first.host) / count;
  }
  double sum_xx = 0;
  double sum_xy = 0;
  for (const Sample& sample : samples_) {
    const double x = to_ns(sample.device - first.device) - mean_device_ns_;
    const double y = to_ns(sample.host - first.host) - mean_host_ns_;
    sum_xx += x * x;
    sum_xy += x * (y - x);
  }
  // Under a second of data the jitter of single samples would pass for drift: crystals are good to
  // 100 ppm.
  const bool is_long_enough = to_ns(samples_.back().device - first.device) > 1e9;
  drift_ = is_long_enough && sum_xx > 0 ? sum_xy / sum_xx : 0;
}

template <typename DeviceClock>
HostTime ClockMap<DeviceClock>::to_host(typename DeviceClock::time_point device) const {
  estimation::check(is_ready(), "clock map used before its first sample");
  const double x = to_ns(device - samples_.front().device) - mean_device_ns_;
  const double host_ns = mean_host_ns_ + x + drift_ * x;
  return samples_.front().host + std::chrono::duration_cast<HostClock::duration>(
                                     std::chrono::nanoseconds(std::llround(host_ns)));
}

template class ClockMap<BoxClock>;
template class ClockMap<CameraClock>;

}  // namespace rig
