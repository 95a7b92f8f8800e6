// The simulated projector's refresh: vertical blanks at multiples of one period on CLOCK_MONOTONIC.
// The GLX shim in the product's process and the grabber in ours agree on it without talking.
// Header-only: the shim links nothing of ours.
#pragma once

#include <chrono>
#include <cmath>
#include <cstdint>

namespace hw_sim {

class ScanoutClock {
 public:
  using TimePoint = std::chrono::steady_clock::time_point;

  explicit ScanoutClock(double refresh_hz) : period_ns_(1e9 / refresh_hz) {}

  std::chrono::nanoseconds period() const {
    return std::chrono::nanoseconds(std::llround(period_ns_));
  }
  TimePoint time_of(std::int64_t blank) const {
    return TimePoint(
        std::chrono::nanoseconds(std::llround(static_cast<double>(blank) * period_ns_)));
  }
  // The last vertical blank at or before `time`.
  std::int64_t blank_at(TimePoint time) const {
    const auto ns = static_cast<double>(
        std::chrono::duration_cast<std::chrono::nanoseconds>(time.time_since_epoch()).count());
    const auto blank = static_cast<std::int64_t>(std::floor(ns / period_ns_));
    return time_of(blank + 1) <= time ? blank + 1 : blank;
  }

 private:
  double period_ns_;
};

}  // namespace hw_sim
