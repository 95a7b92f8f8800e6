#include "rig/trigger_box_protocol.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <random>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace {

using namespace std::chrono_literals;
using namespace rig::tb1;
using rig::Fault;

Record random_record(std::mt19937_64& random) {
  Record record;
  record.type = static_cast<RecordType>(1 + random() % 9);
  record.level = static_cast<std::uint8_t>(random() % 2);
  record.pulse_index = static_cast<std::uint16_t>(random() % 8);
  record.seq = static_cast<std::uint32_t>(random());
  record.edge_number = static_cast<std::uint32_t>(random());
  record.pulse_number = static_cast<std::uint32_t>(random());
  record.time_us = random() >> 12;
  record.run_id = static_cast<std::uint32_t>(random());
  record.dropped_count = static_cast<std::uint32_t>(random());
  return record;
}

Config random_config(std::mt19937_64& random) {
  Config config;
  config.edges = static_cast<Edges>(1 + random() % 3);
  config.pulse_count = static_cast<std::uint8_t>(1 + random() % 8);
  config.delay_rise_us = static_cast<std::uint32_t>(random());
  config.delay_fall_us = static_cast<std::uint32_t>(random());
  for (std::size_t i = 0; i < config.pulse_count; ++i) {
    config.width_us[i] = static_cast<std::uint32_t>(1 + random() % 1'000'000);
  }
  config.gap_us = static_cast<std::uint32_t>(random());
  config.debounce_us = static_cast<std::uint32_t>(random());
  config.threshold_high = static_cast<std::uint16_t>(1 + random() % 1023);
  config.threshold_low = static_cast<std::uint16_t>(random() % config.threshold_high);
  return config;
}

// A configuration with `bytes` changed and its CRC right again.
std::array<std::uint8_t, kConfigBytes> with_crc(std::array<std::uint8_t, kConfigBytes> bytes) {
  const std::uint16_t crc = crc16(std::span(bytes).first(kConfigBytes - 2));
  bytes[kConfigBytes - 2] = static_cast<std::uint8_t>(crc & 0xFF);
  bytes[kConfigBytes - 1] = static_cast<std::uint8_t>(crc >> 8);
  return bytes;
}

TEST(Tb1, CrcIsCcittFalse) {
  // The check value of the catalogue of parametrised CRC algorithms (CRC-16/IBM-3740).
  const std::string digits = "123456789";
  EXPECT_EQ(crc16(std::vector<std::uint8_t>(digits.begin(), digits.end())), 0x29B1);
  EXPECT_EQ(crc16({}), 0xFFFF);
}

TEST(Tb1, RecordIsLittleEndianInTheDocumentedOrder) {
  const Record record{.type = RecordType::kPulseEnd,
                      .level = 1,
                      .pulse_index = 0x0007,
                      .seq = 0x13121110,
                      .edge_number = 0x23222120,
                      .pulse_number = 0x33323130,
                      .time_us = 0x0006454443424140,
                      .run_id = 0x53525150,
                      .dropped_count = 0x63626160};
  const std::array<std::uint8_t, kRecordBytes> expected = {
      4,    1,    0x07, 0x00, 0x10, 0x11, 0x12, 0x13, 0x20, 0x21, 0x22,
      0x23, 0x30, 0x31, 0x32, 0x33, 0x40, 0x41, 0x42, 0x43, 0x44, 0x45,
      0x06, 0x00, 0x50, 0x51, 0x52, 0x53, 0x60, 0x61, 0x62, 0x63};
  EXPECT_EQ(encode(record), expected);
  const auto decoded = decode_record(expected);
  ASSERT_TRUE(decoded) << decoded.error().detail;
  EXPECT_EQ(*decoded, record);
}

TEST(Tb1, RecordsSurviveTheWire) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 1000; ++i) {
    SCOPED_TRACE(i);
    const Record record = random_record(random);
    const auto decoded = decode_record(encode(record));
    ASSERT_TRUE(decoded) << decoded.error().detail;
    EXPECT_EQ(*decoded, record);
  }
}

TEST(Tb1, AnswersSurviveTheWire) {
  const Info info{.protocol_version = 7, .firmware_version = 300, .tick_hz = 48'000'000};
  EXPECT_EQ(*decode_info(encode(info)), info);
  const Status status{.run_id = 65'535,
                      .edge_count = 1,
                      .pulse_count = 2,
                      .ignored_edge_count = 3,
                      .dropped_record_count = 0xFFFFFFFF,
                      .is_armed = true};
  EXPECT_EQ(*decode_status(encode(status)), status);
  const Levels levels{.minimum_adc = 12, .maximum_adc = 1023};
  EXPECT_EQ(*decode_levels(encode(levels)), levels);
  EXPECT_EQ(*decode_time(encode_time(0x0001020304050607)), 0x0001020304050607u);
}

TEST(Tb1, ConfigSurvivesTheWire) {
  std::mt19937_64 random(2);
  for (int i = 0; i < 1000; ++i) {
    SCOPED_TRACE(i);
    const Config config = random_config(random);
    const auto decoded = decode_config(encode(config));
    ASSERT_TRUE(decoded) << decoded.error().detail;
    EXPECT_EQ(*decoded, config);
  }
}

// CRC-16 finds every single- and double-bit error in so short a message.
TEST(Tb1, ConfigWithAnyOneOrTwoBitsFlippedIsRefused) {
  std::mt19937_64 random(3);
  const auto good = encode(random_config(random));
  const auto flip = [](auto bytes, std::size_t bit) {
    bytes[bit / 8] = static_cast<std::uint8_t>(bytes[bit / 8] ^ (1u << (bit % 8)));
    return bytes;
  };
  constexpr std::size_t kBits = 8 * kConfigBytes;
  for (std::size_t first = 0; first < kBits; ++first) {
    EXPECT_FALSE(decode_config(flip(good, first))) << first;
    for (std::size_t second = first + 1; second < kBits; ++second) {
      EXPECT_FALSE(decode_config(flip(flip(good, first), second))) << first << " " << second;
    }
  }
}

TEST(Tb1, ConfigThatABoxCannotRunIsRefusedDespiteItsCrc) {
  Config good;
  good.width_us[0] = 1000;
  ASSERT_TRUE(decode_config(encode(good)));
  const auto refused = [&good](auto change) {
    Config config = good;
    change(config);
    return !decode_config(encode(config));
  };
  EXPECT_TRUE(refused([](Config& c) { c.version = 2; }));
  EXPECT_TRUE(refused([](Config& c) { c.pulse_count = 0; }));
  EXPECT_TRUE(refused([](Config& c) { c.pulse_count = 9; }));
  EXPECT_TRUE(refused([](Config& c) { c.width_us[0] = 0; }));
  EXPECT_TRUE(refused([](Config& c) { c.width_us[1] = 5; }));
  EXPECT_TRUE(refused([](Config& c) { c.threshold_low = c.threshold_high; }));
  EXPECT_TRUE(refused([](Config& c) { c.threshold_high = 1024; }));
  EXPECT_TRUE(refused([](Config& c) { c.edges = static_cast<Edges>(0); }));
  EXPECT_TRUE(refused([](Config& c) { c.edges = static_cast<Edges>(4); }));

  auto with_flags = encode(good);
  with_flags[56] = 1;
  EXPECT_FALSE(decode_config(with_crc(with_flags)));
}

// Whatever comes, the answer is a value or an error, and a value is one that encodes to the same.
TEST(Tb1, RandomBytesNeitherCrashNorDecodeToSomethingElse) {
  std::mt19937_64 random(4);
  for (int i = 0; i < 20'000; ++i) {
    std::vector<std::uint8_t> bytes(random() % 200);
    for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random());
    if (!bytes.empty() && i % 2 == 0) bytes[0] = static_cast<std::uint8_t>(bytes[0] % 11);
    const auto is_same = [&bytes](const auto& encoded) {
      return std::equal(encoded.begin(), encoded.end(), bytes.begin(), bytes.end());
    };
    if (const auto record = decode_record(bytes)) {
      EXPECT_TRUE(is_same(encode(*record)));
    }
    if (const auto info = decode_info(bytes)) {
      EXPECT_TRUE(is_same(encode(*info)));
    }
    if (const auto config = decode_config(bytes)) {
      EXPECT_TRUE(is_same(encode(*config)));
    }
    if (const auto status = decode_status(bytes)) {
      EXPECT_TRUE(is_same(encode(*status)));
    }
    if (const auto levels = decode_levels(bytes)) {
      EXPECT_TRUE(is_same(encode(*levels)));
    }
    if (const auto time_us = decode_time(bytes)) {
      EXPECT_TRUE(is_same(encode_time(*time_us)));
    }
    if (const auto records = decode_records(bytes)) {
      EXPECT_EQ(records->size() * kRecordBytes, bytes.size());
    }
  }
}

TEST(Tb1, EveryWrongLengthIsAnError) {
  std::vector<std::uint8_t> bytes(100, 0);
  bytes[0] = bytes[32] = bytes[64] = 6;  // heartbeats
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    SCOPED_TRACE(size);
    const auto part = std::span(bytes).first(size);
    if (size != kRecordBytes) {
      EXPECT_EQ(decode_record(part).error().fault, Fault::kProtocol);
    }
    if (size != kInfoBytes) {
      EXPECT_EQ(decode_info(part).error().fault, Fault::kProtocol);
    }
    EXPECT_EQ(decode_config(part).error().fault, Fault::kProtocol);
    if (size != kStatusBytes) {
      EXPECT_EQ(decode_status(part).error().fault, Fault::kProtocol);
    }
    if (size != kLevelsBytes) {
      EXPECT_EQ(decode_levels(part).error().fault, Fault::kProtocol);
    }
    if (size != kTimeBytes) {
      EXPECT_EQ(decode_time(part).error().fault, Fault::kProtocol);
    }
    EXPECT_EQ(decode_records(part).has_value(), size % kRecordBytes == 0);
  }
}

TEST(Tb1, TransferWithOneBadRecordIsAnError) {
  std::vector<std::uint8_t> bytes;
  for (int i = 0; i < 3; ++i) {
    const auto record = encode(Record{});
    bytes.insert(bytes.end(), record.begin(), record.end());
  }
  EXPECT_EQ(decode_records(bytes)->size(), 3u);
  bytes[32] = 10;  // the second's type
  EXPECT_EQ(decode_records(bytes).error().fault, Fault::kProtocol);
}

TEST(Tb1, SettingsBecomeAConfig) {
  const rig::TriggerSettings settings{.delay_rise = 1ms,
                                      .delay_fall = 4ms,
                                      .gap = 5ms,
                                      .debounce = 2ms,
                                      .threshold_high = 700,
                                      .threshold_low = 300};
  const auto config = make_config(settings, {1ms, 8ms});
  ASSERT_TRUE(config) << config.error().detail;
  EXPECT_EQ(config->edges, Edges::kBoth);
  EXPECT_EQ(config->pulse_count, 2);
  EXPECT_THAT(config->width_us, testing::ElementsAre(1000, 8000, 0, 0, 0, 0, 0, 0));
  EXPECT_EQ(config->delay_rise_us, 1000u);
  EXPECT_EQ(config->delay_fall_us, 4000u);
  EXPECT_EQ(config->gap_us, 5000u);
  EXPECT_EQ(config->debounce_us, 2000u);
  EXPECT_EQ(config->threshold_high, 700);
  EXPECT_EQ(config->threshold_low, 300);
}

TEST(Tb1, SettingsThatNoBoxCanRunAreOutOfRange) {
  const auto fault_of = [](const rig::TriggerSettings& settings,
                           const std::vector<std::chrono::microseconds>& widths) {
    return make_config(settings, widths).error().fault;
  };
  const rig::TriggerSettings good;
  EXPECT_EQ(fault_of(good, {}), Fault::kOutOfRange);
  EXPECT_EQ(fault_of(good, std::vector(9, 100us)), Fault::kOutOfRange);
  EXPECT_EQ(fault_of(good, {0us}), Fault::kOutOfRange);
  EXPECT_EQ(fault_of(good, {-1us}), Fault::kOutOfRange);
  EXPECT_EQ(fault_of(good, {2h}), Fault::kOutOfRange);
  EXPECT_EQ(fault_of({.gap = -1us}, {100us}), Fault::kOutOfRange);
  EXPECT_EQ(fault_of({.threshold_high = 400, .threshold_low = 400}, {100us}), Fault::kOutOfRange);
}

// ---- RecordReader ----

class RecordReaderTest : public testing::Test {
 protected:
  RecordReaderTest() {
    clock.add(to_time_point(1'000'000), kHostAtOneSecond, 1us);
    read({.type = RecordType::kArmed, .seq = 0});
  }

  std::vector<rig::Event> read(Record record) {
    record.run_id = 5;
    return reader.read(record, clock);
  }
  static const rig::DeviceFault& fault_in(const std::vector<rig::Event>& events) {
    return std::get<rig::DeviceFault>(events.at(0));
  }

  static constexpr rig::HostTime kHostAtOneSecond{1h};
  rig::ClockMap<rig::BoxClock> clock;
  RecordReader reader{5};
};

TEST_F(RecordReaderTest, EdgeAndPulsesBecomeEventsOnTheHostsClock) {
  const auto edge = read(
      {.type = RecordType::kEdge, .level = 1, .seq = 1, .edge_number = 1, .time_us = 1'002'000});
  ASSERT_EQ(edge.size(), 1u);
  EXPECT_EQ(std::get<rig::EdgeSeen>(edge[0]).edge_number, 1u);
  EXPECT_TRUE(std::get<rig::EdgeSeen>(edge[0]).is_light);
  EXPECT_EQ(std::get<rig::EdgeSeen>(edge[0]).time, kHostAtOneSecond + 2ms);

  EXPECT_TRUE(read({.type = RecordType::kPulseStart,
                    .pulse_index = 2,
                    .seq = 2,
                    .edge_number = 1,
                    .pulse_number = 3,
                    .time_us = 1'003'000})
                  .empty());
  const auto pulse = read({.type = RecordType::kPulseEnd,
                           .pulse_index = 2,
                           .seq = 3,
                           .edge_number = 1,
                           .pulse_number = 3,
                           .time_us = 1'013'000});
  ASSERT_EQ(pulse.size(), 1u);
  const auto& ended = std::get<rig::PulseEnded>(pulse[0]);
  EXPECT_EQ(ended.edge_number, 1u);
  EXPECT_EQ(ended.pulse_index, 2);
  EXPECT_EQ(ended.pulse_number, 3u);
  EXPECT_EQ(ended.started, kHostAtOneSecond + 3ms);
  EXPECT_EQ(ended.ended, kHostAtOneSecond + 13ms);

  const auto ignored = read({.type = RecordType::kIgnoredEdge, .seq = 4, .edge_number = 1});
  ASSERT_EQ(ignored.size(), 1u);
  EXPECT_FALSE(std::get<rig::EdgeIgnored>(ignored[0]).is_light);
}

TEST_F(RecordReaderTest, GapInTheSequenceIsReportedOnceAndReadingGoesOn) {
  const auto after_gap = read({.type = RecordType::kEdge, .seq = 3, .edge_number = 2});
  ASSERT_EQ(after_gap.size(), 2u);
  EXPECT_EQ(fault_in(after_gap).error.fault, Fault::kSequenceGap);
  EXPECT_EQ(fault_in(after_gap).device, rig::Device::kTrigger);
  EXPECT_EQ(std::get<rig::EdgeSeen>(after_gap[1]).edge_number, 2u);
  EXPECT_TRUE(read({.type = RecordType::kHeartbeat, .seq = 4}).empty());
}

TEST_F(RecordReaderTest, LostArmedRecordIsAGap) {
  RecordReader fresh(5);
  const auto events =
      fresh.read({.type = RecordType::kEdge, .seq = 1, .edge_number = 1, .run_id = 5}, clock);
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(fault_in(events).error.fault, Fault::kSequenceGap);
}

TEST_F(RecordReaderTest, OverflowIsOneFault) {
  const auto events = read({.type = RecordType::kOverflow, .seq = 41, .dropped_count = 40});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(fault_in(events).error.fault, Fault::kSequenceGap);
  EXPECT_THAT(fault_in(events).error.detail, testing::HasSubstr("40 records"));
}

TEST_F(RecordReaderTest, PulseWhoseStartWasLostIsNotReportedTwice) {
  EXPECT_EQ(read({.type = RecordType::kPulseEnd, .seq = 2, .pulse_number = 1}).size(), 1u);
}

TEST_F(RecordReaderTest, PulseThatNeverStartedIsAProtocolFault) {
  const auto events = read({.type = RecordType::kPulseEnd, .seq = 1, .pulse_number = 1});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(fault_in(events).error.fault, Fault::kProtocol);
}

TEST_F(RecordReaderTest, BoxThatReportsItsOwnFaultIsLost) {
  const auto events = read({.type = RecordType::kFault, .pulse_index = 3, .seq = 1});
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(fault_in(events).error.fault, Fault::kDeviceLost);
}

TEST_F(RecordReaderTest, OtherRunsAreIgnored) {
  EXPECT_TRUE(reader.read({.type = RecordType::kEdge, .seq = 77, .run_id = 4}, clock).empty());
  EXPECT_EQ(read({.type = RecordType::kEdge, .seq = 1, .edge_number = 1}).size(), 1u);
}

TEST_F(RecordReaderTest, HeartbeatsOfAnEarlierRunWithTheSameIdAreNoGap) {
  RecordReader fresh(5);
  EXPECT_TRUE(fresh.read({.type = RecordType::kHeartbeat, .seq = 900, .run_id = 5}, clock).empty());
  EXPECT_TRUE(fresh.read({.type = RecordType::kArmed, .seq = 0, .run_id = 5}, clock).empty());
}

TEST_F(RecordReaderTest, OnlySixteenBitsOfARunIdTravel) {
  RecordReader wide(0x1234'0005);
  EXPECT_TRUE(wide.read({.type = RecordType::kArmed, .seq = 0, .run_id = 5}, clock).empty());
  EXPECT_EQ(
      wide.read({.type = RecordType::kEdge, .seq = 1, .edge_number = 1, .run_id = 5}, clock).size(),
      1u);
}

}  // namespace
