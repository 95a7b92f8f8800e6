#include "hw_sim/trigger_box_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include "rig/trigger_box_protocol.h"

namespace {

using namespace std::chrono_literals;
using hw_sim::BoxOutput;
using hw_sim::TriggerBoxModel;
using rig::HostTime;
using rig::tb1::Config;
using rig::tb1::Edges;
using rig::tb1::Record;
using rig::tb1::RecordType;
using rig::tb1::Request;
using testing::ElementsAre;

constexpr HostTime kPowerUp{std::chrono::hours(1)};
constexpr int kDark_adc = 50;
constexpr int kLight_adc = 950;

class TriggerBoxModelTest : public testing::Test {
 protected:
  static Config config_of(const std::vector<std::uint32_t>& widths_us) {
    Config config;
    config.pulse_count = static_cast<std::uint8_t>(widths_us.size());
    std::copy(widths_us.begin(), widths_us.end(), config.width_us.begin());
    config.gap_us = 5000;
    config.debounce_us = 2000;
    return config;
  }

  std::optional<std::vector<std::uint8_t>> ask(Request request, std::uint16_t value = 0,
                                               const std::vector<std::uint8_t>& data = {}) {
    return box.control(static_cast<std::uint8_t>(request), value, data, kPowerUp + now);
  }
  bool set_config(const Config& config) {
    const auto bytes = rig::tb1::encode(config);
    return ask(Request::kSetConfig, 0, {bytes.begin(), bytes.end()}).has_value();
  }
  // Armed as run 1 with the light off, and everything said so far forgotten.
  void arm(const Config& config) {
    ASSERT_TRUE(set_config(config));
    ASSERT_TRUE(ask(Request::kArm, 1));
    box.advance(kPowerUp + now);
  }

  void light_at(std::chrono::nanoseconds time, int level_adc) {
    box.light(kPowerUp + time, level_adc);
  }
  BoxOutput advance(std::chrono::nanoseconds time) {
    now = time;
    return box.advance(kPowerUp + time);
  }
  // Without heartbeats, which come every 100 ms whatever else happens.
  static std::vector<Record> events_of(const BoxOutput& output) {
    std::vector<Record> events;
    for (const Record& record : output.records) {
      if (record.type != RecordType::kHeartbeat) events.push_back(record);
    }
    return events;
  }
  static std::vector<RecordType> types_of(const BoxOutput& output) {
    std::vector<RecordType> types;
    for (const Record& record : events_of(output)) types.push_back(record.type);
    return types;
  }
  rig::tb1::Status status() { return *rig::tb1::decode_status(*ask(Request::kGetStatus)); }

  std::chrono::nanoseconds now{0};
  TriggerBoxModel box{kPowerUp};
};

// ---- Light ----

TEST_F(TriggerBoxModelTest, TrainIsExactToTheMicrosecondHoweverLateItIsLookedAt) {
  Config config = config_of({1000, 4000, 16000});
  config.delay_rise_us = 300;
  arm(config);
  light_at(10ms, kLight_adc);
  const BoxOutput output = advance(90ms);

  const auto start = kPowerUp + 10ms + 300us;
  ASSERT_EQ(output.pulses.size(), 3u);
  EXPECT_EQ(output.pulses[0].start, start);
  EXPECT_EQ(output.pulses[0].width, 1ms);
  EXPECT_EQ(output.pulses[1].start, start + 1ms + 5ms);
  EXPECT_EQ(output.pulses[1].width, 4ms);
  EXPECT_EQ(output.pulses[2].start, start + 1ms + 5ms + 4ms + 5ms);
  EXPECT_EQ(output.pulses[2].width, 16ms);

  const std::vector<Record> records = events_of(output);
  ASSERT_THAT(types_of(output),
              ElementsAre(RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd,
                          RecordType::kPulseStart, RecordType::kPulseEnd, RecordType::kPulseStart,
                          RecordType::kPulseEnd));
  std::vector<std::uint64_t> times_us;
  for (std::size_t i = 0; i < records.size(); ++i) {
    SCOPED_TRACE(i);
    times_us.push_back(records[i].time_us);
    EXPECT_EQ(records[i].seq, i + 1);  // ARMED was 0
    EXPECT_EQ(records[i].run_id, 1u);
    EXPECT_EQ(records[i].edge_number, 1u);
    EXPECT_EQ(records[i].level, 1);
    if (i == 0) continue;
    EXPECT_EQ(records[i].pulse_index, (i - 1) / 2);
    EXPECT_EQ(records[i].pulse_number, (i - 1) / 2 + 1);
  }
  EXPECT_THAT(times_us, ElementsAre(10000, 10300, 11300, 16300, 20300, 25300, 41300));
}

TEST_F(TriggerBoxModelTest, RiseAndFallHaveTheirOwnDelays) {
  Config config = config_of({1000});
  config.delay_rise_us = 0;
  config.delay_fall_us = 4000;
  arm(config);
  light_at(10ms, kLight_adc);
  light_at(20ms, kDark_adc);
  const BoxOutput output = advance(50ms);
  ASSERT_EQ(output.pulses.size(), 2u);
  EXPECT_EQ(output.pulses[0].start, kPowerUp + 10ms);
  EXPECT_EQ(output.pulses[1].start, kPowerUp + 24ms);
}

TEST_F(TriggerBoxModelTest, EdgesNeedTheLevelBeyondTheFarThreshold) {
  arm(config_of({1000}));
  light_at(10ms, 600);  // not above
  EXPECT_TRUE(events_of(advance(15ms)).empty());
  light_at(20ms, 601);
  EXPECT_EQ(events_of(advance(30ms)).size(), 3u);
  light_at(40ms, 400);  // not below
  EXPECT_TRUE(events_of(advance(45ms)).empty());
  light_at(50ms, 399);
  EXPECT_EQ(events_of(advance(60ms)).size(), 3u);
}

TEST_F(TriggerBoxModelTest, ColourWheelRippleWithinTheHysteresisIsNoEdge) {
  arm(config_of({1000}));
  light_at(5ms, kLight_adc);
  advance(20ms);
  // 720 Hz segments of a DLP wheel, down to just above the lower threshold, for a second.
  for (int i = 0; i < 1440; ++i) {
    const auto time = 20ms + i * 694us;
    light_at(time, i % 2 == 0 ? 401 : 1000);
    EXPECT_TRUE(events_of(advance(time)).empty());
  }
  EXPECT_EQ(status().edge_count, 1u);
  EXPECT_EQ(status().ignored_edge_count, 0u);
}

TEST_F(TriggerBoxModelTest, NoiseOnASlowFallIsOneEdge) {
  Config config = config_of({1000});
  config.delay_fall_us = 0;
  arm(config);
  light_at(5ms, kLight_adc);
  advance(20ms);
  std::mt19937_64 random(3);
  // A photodiode that needs 4 ms to fall, with noise of up to 60 counts, sampled every 10 us.
  const auto start = 20ms;
  std::optional<std::chrono::nanoseconds> expected;
  for (auto time = 0us; time < 30ms; time += 10us) {
    const double decay = std::exp(-static_cast<double>(time.count()) / 4000.0);
    const int level_adc =
        static_cast<int>(kLight_adc * decay) + static_cast<int>(random() % 121) - 60;
    if (!expected && level_adc < 400) expected = start + time;
    light_at(start + time, level_adc);
  }
  const BoxOutput output = advance(60ms);
  ASSERT_EQ(output.pulses.size(), 1u);
  EXPECT_EQ(output.pulses[0].start, kPowerUp + *expected);
  EXPECT_EQ(status().edge_count, 2u);
  EXPECT_EQ(status().ignored_edge_count, 0u);
}

TEST_F(TriggerBoxModelTest, EdgeDuringATrainIsIgnoredAndReported) {
  arm(config_of({20000, 20000}));
  light_at(10ms, kLight_adc);
  light_at(32ms, kDark_adc);  // in the gap
  const BoxOutput output = advance(80ms);
  EXPECT_EQ(output.pulses.size(), 2u);
  const std::vector<Record> records = events_of(output);
  ASSERT_THAT(types_of(output), ElementsAre(RecordType::kEdge, RecordType::kPulseStart,
                                            RecordType::kPulseEnd, RecordType::kIgnoredEdge,
                                            RecordType::kPulseStart, RecordType::kPulseEnd));
  EXPECT_EQ(records[3].level, 0);
  EXPECT_EQ(records[3].time_us, 32000u);
  EXPECT_EQ(status().ignored_edge_count, 1u);
}

TEST_F(TriggerBoxModelTest, EdgeDuringTheDelayIsDuringTheTrain) {
  Config config = config_of({1000});
  config.delay_rise_us = 10'000;
  arm(config);
  light_at(10ms, kLight_adc);
  light_at(15ms, kDark_adc);
  EXPECT_EQ(advance(50ms).pulses.size(), 1u);
  EXPECT_EQ(status().ignored_edge_count, 1u);
}

TEST_F(TriggerBoxModelTest, DebounceEndsAfterItsTimeToTheMicrosecond) {
  Config config = config_of({100});
  arm(config);
  light_at(10ms, kLight_adc);
  light_at(10ms + 1999us, kDark_adc);
  light_at(20ms, kLight_adc);
  light_at(20ms + 2000us, kDark_adc);
  EXPECT_THAT(types_of(advance(60ms)),
              ElementsAre(RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd,
                          RecordType::kIgnoredEdge,  //
                          RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd,
                          RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd));
}

TEST_F(TriggerBoxModelTest, FlickerTriggersOnceOnly) {
  arm(config_of({100}));
  for (int i = 0; i < 100; ++i) light_at(10ms + i * 1ms, i % 2 == 0 ? kLight_adc : kDark_adc);
  EXPECT_EQ(advance(150ms).pulses.size(), 1u);
  EXPECT_EQ(status().ignored_edge_count, 99u);
}

TEST_F(TriggerBoxModelTest, EdgesThatWereNotAskedForAreNothing) {
  Config config = config_of({1000});
  config.edges = Edges::kFall;
  arm(config);
  light_at(10ms, kLight_adc);
  EXPECT_TRUE(events_of(advance(15ms)).empty());
  light_at(20ms, kDark_adc);
  EXPECT_THAT(types_of(advance(30ms)),
              ElementsAre(RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd));
}

TEST_F(TriggerBoxModelTest, LateLightKeepsItsTimeUnlessSomethingHasHappenedSince) {
  arm(config_of({1000}));
  advance(40ms);
  light_at(38ms, kLight_adc);
  EXPECT_EQ(advance(45ms).pulses.at(0).start, kPowerUp + 38ms);
  advance(101ms);  // the heart beat at 100 ms
  light_at(99ms, kDark_adc);
  EXPECT_EQ(advance(110ms).pulses.at(0).start, kPowerUp + 100ms);
}

// ---- Time ----

TEST_F(TriggerBoxModelTest, HeartBeatsEveryTenthOfASecondArmedOrNot) {
  EXPECT_EQ(*box.next_due(), kPowerUp + 100ms);
  const BoxOutput output = advance(350ms);
  ASSERT_EQ(output.records.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(output.records[i].type, RecordType::kHeartbeat);
    EXPECT_EQ(output.records[i].time_us, 100'000 * (i + 1));
  }
  arm(config_of({1000}));
  EXPECT_EQ(advance(1000ms).records.size(), 7u);
}

TEST_F(TriggerBoxModelTest, NextDueIsThePulsesNextFlank) {
  Config config = config_of({1000});
  config.delay_rise_us = 500;
  arm(config);
  light_at(10ms, kLight_adc);
  EXPECT_EQ(*box.next_due(), kPowerUp + 10'500us);
  advance(10'500us);
  EXPECT_EQ(*box.next_due(), kPowerUp + 11'500us);
  advance(11'500us);
  EXPECT_EQ(*box.next_due(), kPowerUp + 100ms);
}

TEST_F(TriggerBoxModelTest, CrystalMayDrift) {
  const TriggerBoxModel fast(kPowerUp, 100);
  EXPECT_EQ(fast.time_us(kPowerUp + 10s), 10'001'000u);
  const TriggerBoxModel slow(kPowerUp, -100);
  EXPECT_EQ(slow.time_us(kPowerUp + 10s), 9'999'000u);
  EXPECT_EQ(fast.time_us(kPowerUp - 1s), 0u);
}

// ---- Requests ----

TEST_F(TriggerBoxModelTest, SaysItsVersionAndTime) {
  now = 123'456us;
  const auto info = rig::tb1::decode_info(*ask(Request::kGetInfo));
  EXPECT_EQ(info->protocol_version, rig::tb1::kProtocolVersion);
  EXPECT_EQ(info->tick_hz, 1'000'000u);
  EXPECT_EQ(*rig::tb1::decode_time(*ask(Request::kGetTime)), 123'456u);
}

TEST_F(TriggerBoxModelTest, ConfigReadsBackAndBadOnesStall) {
  EXPECT_FALSE(ask(Request::kGetConfig));
  EXPECT_FALSE(ask(Request::kArm, 1));  // not configured
  const Config good = config_of({1000, 2000});
  ASSERT_TRUE(set_config(good));
  EXPECT_EQ(*rig::tb1::decode_config(*ask(Request::kGetConfig)), good);

  Config crossed = good;
  crossed.threshold_low = crossed.threshold_high;
  EXPECT_FALSE(set_config(crossed));
  EXPECT_FALSE(set_config(config_of({})));
  auto bytes = rig::tb1::encode(good);
  bytes[20] ^= 1;  // against its CRC
  EXPECT_FALSE(ask(Request::kSetConfig, 0, {bytes.begin(), bytes.end()}));
  EXPECT_FALSE(ask(Request::kSetConfig));
  EXPECT_EQ(*rig::tb1::decode_config(*ask(Request::kGetConfig)), good);
}

TEST_F(TriggerBoxModelTest, ConfigStallsWhileArmed) {
  arm(config_of({1000}));
  EXPECT_FALSE(set_config(config_of({2000})));
  ask(Request::kDisarm);
  EXPECT_TRUE(set_config(config_of({2000})));
}

TEST_F(TriggerBoxModelTest, UnknownRequestsStallAndRandomOnesDoNotCrash) {
  std::mt19937_64 random(5);
  for (int request = 0; request < 256; ++request) {
    for (int i = 0; i < 8; ++i) {
      std::vector<std::uint8_t> data(random() % 100);
      for (auto& byte : data) byte = static_cast<std::uint8_t>(random());
      const auto answer = box.control(static_cast<std::uint8_t>(request),
                                      static_cast<std::uint16_t>(random()), data, kPowerUp);
      if (request == 0 || request > 9) {
        EXPECT_FALSE(answer) << request;
      }
    }
  }
}

TEST_F(TriggerBoxModelTest, ArmingStartsARunFromNothing) {
  arm(config_of({1000}));
  light_at(10ms, kLight_adc);
  advance(20ms);
  light_at(30ms, kDark_adc);
  ASSERT_TRUE(ask(Request::kArm, 2));  // clears what was not fetched
  const BoxOutput output = advance(40ms);
  ASSERT_EQ(output.records.size(), 1u);
  EXPECT_EQ(output.records[0].type, RecordType::kArmed);
  EXPECT_EQ(output.records[0].seq, 0u);
  EXPECT_EQ(output.records[0].run_id, 2u);
  EXPECT_EQ(output.records[0].edge_number, 0u);
  EXPECT_TRUE(box.is_armed());
  EXPECT_EQ(status(), (rig::tb1::Status{.run_id = 2, .is_armed = true}));
}

TEST_F(TriggerBoxModelTest, DisarmingReportsTheTotalsAndStopsTheTrain) {
  arm(config_of({1000, 1000}));
  light_at(10ms, kLight_adc);
  light_at(10'500us, kDark_adc);
  advance(13ms);
  now = 14ms;
  ask(Request::kDisarm);
  const BoxOutput output = advance(60ms);
  EXPECT_TRUE(output.pulses.empty());
  ASSERT_THAT(types_of(output), ElementsAre(RecordType::kDisarmed));
  const Record totals = events_of(output)[0];
  EXPECT_EQ(totals.edge_number, 1u);
  EXPECT_EQ(totals.pulse_number, 1u);
  EXPECT_EQ(totals.pulse_index, 1u);  // ignored edges
  EXPECT_EQ(totals.time_us, 14'000u);
  EXPECT_FALSE(box.is_armed());
  light_at(70ms, kLight_adc);
  EXPECT_TRUE(events_of(advance(90ms)).empty());
  EXPECT_TRUE(ask(Request::kDisarm));  // once more is no fault
  EXPECT_TRUE(events_of(advance(95ms)).empty());
}

TEST_F(TriggerBoxModelTest, SoftTriggerIsAnEdgeWithoutLightOrDelay) {
  Config config = config_of({1000});
  config.delay_rise_us = config.delay_fall_us = 7000;
  EXPECT_FALSE(ask(Request::kSoftTrigger));
  arm(config);
  now = 10ms;
  EXPECT_TRUE(ask(Request::kSoftTrigger));
  EXPECT_FALSE(ask(Request::kSoftTrigger));  // the train runs
  const BoxOutput output = advance(20ms);
  EXPECT_EQ(output.pulses.at(0).start, kPowerUp + 10ms);
  EXPECT_THAT(types_of(output),
              ElementsAre(RecordType::kEdge, RecordType::kPulseStart, RecordType::kPulseEnd));
  EXPECT_EQ(events_of(output)[0].level, 0);
  EXPECT_TRUE(ask(Request::kSoftTrigger));
}

TEST_F(TriggerBoxModelTest, LevelsAreThoseSinceTheLastAnswer) {
  light_at(1ms, 300);
  light_at(2ms, 20);
  light_at(3ms, 2000);  // the converter saturates
  light_at(4ms, 500);
  const auto levels = [this] { return *rig::tb1::decode_levels(*ask(Request::kGetLevel)); };
  EXPECT_EQ(levels(), (rig::tb1::Levels{0, 1023}));
  EXPECT_EQ(levels(), (rig::tb1::Levels{500, 500}));
  light_at(5ms, 510);
  EXPECT_EQ(levels(), (rig::tb1::Levels{500, 510}));
}

TEST_F(TriggerBoxModelTest, RecordsWithoutRoomAreCountedAndOwned) {
  arm(config_of({1000}));
  box.set_queue_full(true);
  light_at(10ms, kLight_adc);
  EXPECT_TRUE(advance(20ms).records.empty());
  EXPECT_EQ(status().dropped_record_count, 3u);
  box.set_queue_full(false);
  light_at(30ms, kDark_adc);
  const BoxOutput output = advance(40ms);
  const std::vector<Record> records = events_of(output);
  ASSERT_THAT(types_of(output), ElementsAre(RecordType::kOverflow, RecordType::kEdge,
                                            RecordType::kPulseStart, RecordType::kPulseEnd));
  EXPECT_EQ(records[0].seq, 4u);  // 1 to 3 are missing
  EXPECT_EQ(records[0].dropped_count, 3u);
  EXPECT_EQ(records[1].edge_number, 2u);
}

}  // namespace
