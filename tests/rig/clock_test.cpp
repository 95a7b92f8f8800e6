#include "rig/clock.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <limits>
#include <random>

namespace {

using namespace std::chrono_literals;
using std::chrono::microseconds;
using std::chrono::nanoseconds;

using BoxTime = rig::BoxClock::time_point;

constexpr rig::HostTime kHostStart{std::chrono::hours(100)};
constexpr BoxTime kBoxStart{std::chrono::hours(3)};

// A box clock that runs `drift_ppm` fast against the host's.
struct Crystal {
  double drift_ppm = 0;
  BoxTime at(nanoseconds elapsed) const {
    const double ns = static_cast<double>(elapsed.count()) * (1 + drift_ppm * 1e-6);
    return kBoxStart + microseconds(static_cast<std::int64_t>(ns / 1000));
  }
};

double error_us(const rig::ClockMap<rig::BoxClock>& map, const Crystal& crystal,
                nanoseconds elapsed) {
  const auto error = map.to_host(crystal.at(elapsed)) - (kHostStart + elapsed);
  return std::chrono::duration<double, std::micro>(error).count();
}

// Round trips of 10 a second for `duration`: `jitter` late or early at most, as certain as they
// are.
template <typename Draw>
rig::ClockMap<rig::BoxClock> map_of(const Crystal& crystal, nanoseconds duration, Draw draw_error) {
  rig::ClockMap<rig::BoxClock> map;
  for (nanoseconds elapsed = 0ns; elapsed <= duration; elapsed += 100ms) {
    const auto [error, uncertainty] = draw_error();
    map.add(crystal.at(elapsed), kHostStart + elapsed + error, uncertainty);
  }
  return map;
}

struct Sample {
  nanoseconds error, uncertainty;
};

TEST(ClockMap, OneSampleGivesTheOffset) {
  rig::ClockMap<rig::BoxClock> map;
  EXPECT_FALSE(map.is_ready());
  map.add(kBoxStart, kHostStart, 100us);
  EXPECT_TRUE(map.is_ready());
  EXPECT_EQ(map.to_host(kBoxStart), kHostStart);
  EXPECT_EQ(map.to_host(kBoxStart + 250ms), kHostStart + 250ms);
  EXPECT_EQ(map.to_host(kBoxStart - 250ms), kHostStart - 250ms);
  EXPECT_EQ(map.best_uncertainty(), 100us);
}

TEST(ClockMap, FollowsDriftOfEitherSign) {
  for (const double drift_ppm : {-80.0, -5.0, 0.0, 20.0, 80.0}) {
    SCOPED_TRACE(drift_ppm);
    const Crystal crystal{drift_ppm};
    const auto map = map_of(crystal, 6s, [] { return Sample{0ns, 1us}; });
    EXPECT_NEAR(map.drift_ppm(), -drift_ppm, 1.0);  // box ticks of 1 us over 6 s: 0.2 ppm
    EXPECT_NEAR(error_us(map, crystal, 6s), 0, 2);
    EXPECT_NEAR(error_us(map, crystal, 16s), 0, 15);  // ten seconds beyond the last sample
  }
}

TEST(ClockMap, ForgetsAnOldDriftAsTheCrystalWarms) {
  rig::ClockMap<rig::BoxClock> map;
  BoxTime box = kBoxStart;
  rig::HostTime host = kHostStart;
  for (int i = 0; i < 400; ++i) {
    box += i < 200 ? 100'010us : 100'000us;  // 100 ppm fast, then true
    host += 100ms;
    map.add(box, host, 10us);
  }
  EXPECT_NEAR(map.drift_ppm(), 0, 0.1);
  EXPECT_LT(std::chrono::abs(map.to_host(box) - host), 2us);
}

TEST(ClockMap, AveragesJitter) {
  std::mt19937_64 random(7);
  const Crystal crystal{30};
  const auto map = map_of(crystal, 6s, [&random] {
    return Sample{microseconds(static_cast<int>(random() % 401) - 200), 200us};
  });
  // Uniform +-200 us is 115 us rms; over 61 samples 15 us, at the end of the line twice that.
  EXPECT_NEAR(error_us(map, crystal, 6s), 0, 90);
  EXPECT_NEAR(error_us(map, crystal, 3s), 0, 45);
}

TEST(ClockMap, FewJitteringSamplesDoNotPassForDrift) {
  std::mt19937_64 random(8);
  const auto map = map_of(Crystal{0}, 300ms, [&random] {
    return Sample{microseconds(static_cast<int>(random() % 401) - 200), 200us};
  });
  EXPECT_LT(std::abs(map.drift_ppm()), 50);
  EXPECT_NEAR(error_us(map, Crystal{0}, 1s), 0, 250);
}

TEST(ClockMap, SlowRoundTripsHardlyCount) {
  std::mt19937_64 random(9);
  const Crystal crystal{40};
  const auto map = map_of(crystal, 6s, [&random]() -> Sample {
    if (random() % 4 == 0) return {5ms, 5ms};  // held up on the way back
    return {microseconds(static_cast<int>(random() % 41) - 20), 20us};
  });
  EXPECT_NEAR(error_us(map, crystal, 6s), 0, 20);
  EXPECT_EQ(map.best_uncertainty(), 20us);
}

TEST(ClockMap, OneLuckySampleDoesNotFreezeTheMap) {
  rig::ClockMap<rig::BoxClock> map;
  const Crystal crystal{90};
  map.add(crystal.at(0ns), kHostStart, 1us);
  for (nanoseconds elapsed = 100ms; elapsed <= 60s; elapsed += 100ms) {
    map.add(crystal.at(elapsed), kHostStart + elapsed, 300us);
  }
  EXPECT_NEAR(error_us(map, crystal, 60s), 0, 30);  // frozen it would be 5400
  EXPECT_EQ(map.best_uncertainty(), 300us);
}

TEST(ClockMap, PerfectSamplesAreNoDivisionByZero) {
  const Crystal crystal{0};
  const auto map = map_of(crystal, 1s, [] { return Sample{0ns, 0ns}; });
  EXPECT_NEAR(error_us(map, crystal, 500ms), 0, 1);
}

// A box may say anything: found by tests/fuzz.
TEST(ClockMap, ATimeCenturiesAwayIsAHostTimeAllTheSame) {
  const BoxTime farthest(microseconds(std::numeric_limits<std::int64_t>::max() / 1000));
  rig::ClockMap<rig::BoxClock> map;
  map.add(BoxTime(0us), kHostStart, 50us);
  EXPECT_GT(map.to_host(farthest), kHostStart);
  map.add(BoxTime(5ms), kHostStart + std::chrono::hours(1), 50us);
  EXPECT_GT(map.to_host(farthest), kHostStart);
}

TEST(ClockMap, CameraNanosecondsKeepTheirPrecisionAfterYears) {
  rig::ClockMap<rig::CameraClock> map;
  const rig::CameraClock::time_point start{std::chrono::hours(24 * 365 * 5)};
  for (int i = 0; i < 64; ++i) map.add(start + i * 100ms, kHostStart + i * 100ms, 1us);
  const auto error = map.to_host(start + 3'210'000'123ns) - (kHostStart + 3'210'000'123ns);
  EXPECT_LE(std::chrono::abs(error), 2ns);
}

}  // namespace
