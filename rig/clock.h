// Clocks of a rig, each a type of its own, and the map between two of them.
#pragma once

#include <chrono>
#include <cstddef>
#include <deque>

namespace rig {

using HostClock = std::chrono::steady_clock;  // CLOCK_MONOTONIC
using HostTime = HostClock::time_point;

// The trigger box's microsecond counter; starts anywhere.
struct BoxClock {
  using duration = std::chrono::microseconds;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::time_point<BoxClock>;
  // NOLINTNEXTLINE(readability-identifier-naming): the standard's name for it
  static constexpr bool is_steady = true;
};

// The camera's timestamp counter in ns; starts anywhere.
struct CameraClock {
  using duration = std::chrono::nanoseconds;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::time_point<CameraClock>;
  // NOLINTNEXTLINE(readability-identifier-naming): the standard's name for it
  static constexpr bool is_steady = true;
};

// Host time of a device time: offset and drift by least squares over the latest samples, each with
// the weight 1 / uncertainty^2, so that a slow round trip among quick ones hardly counts. Drift is
// expected within some 100 ppm, so that the jitter of few samples does not pass for it. Not
// thread-safe.
template <typename DeviceClock>
class ClockMap {
 public:
  // `host` is when the device's clock read `device`, give or take `uncertainty`.
  void add(typename DeviceClock::time_point device, HostTime host,
           std::chrono::nanoseconds uncertainty);
  bool is_ready() const { return !samples_.empty(); }
  // check() fails before the first sample.
  HostTime to_host(typename DeviceClock::time_point device) const;
  double drift_ppm() const { return drift_ * 1e6; }
  // The smallest among the latest samples; the map is about that good.
  std::chrono::nanoseconds best_uncertainty() const;

 private:
  static constexpr std::size_t kSampleLimit = 64;  // at 10 heartbeats a second: the last 6 s
  struct Sample {
    typename DeviceClock::time_point device;
    HostTime host;
    std::chrono::nanoseconds uncertainty;
  };
  void fit();

  std::deque<Sample> samples_;
  double mean_device_ns_ = 0;  // weighted; relative to the first sample
  double mean_host_ns_ = 0;
  double drift_ = 0;  // host ns per device ns, minus one
};

extern template class ClockMap<BoxClock>;
extern template class ClockMap<CameraClock>;

}  // namespace rig
