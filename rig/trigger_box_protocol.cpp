#include "rig/trigger_box_protocol.h"

#include <algorithm>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>

#include "estimation/base/check.h"

namespace rig::tb1 {
namespace {

// A signed 64-bit count of ns has to hold it.
constexpr std::uint64_t kTimeLimit_us = std::numeric_limits<std::int64_t>::max() / 1000;

template <std::size_t Size>
class Writer {
 public:
  template <typename Number>
  Writer& put(Number number) {
    static_assert(std::is_unsigned_v<Number>);
    for (std::size_t byte = 0; byte < sizeof(Number); ++byte) {
      bytes_.at(size_++) =
          static_cast<std::uint8_t>(static_cast<std::uint64_t>(number) >> (8 * byte));
    }
    return *this;
  }
  std::span<const std::uint8_t> written() const { return std::span(bytes_).first(size_); }
  std::array<std::uint8_t, Size> finish() const {
    estimation::check(size_ == Size, "TB1 structure written with another size than it has");
    return bytes_;
  }

 private:
  std::array<std::uint8_t, Size> bytes_{};
  std::size_t size_ = 0;
};

// The caller has checked the length.
class Reader {
 public:
  explicit Reader(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}

  template <typename Number>
  Number take() {
    std::uint64_t number = 0;
    for (std::size_t byte = 0; byte < sizeof(Number); ++byte) {
      number |= static_cast<std::uint64_t>(bytes_[position_++]) << (8 * byte);
    }
    return static_cast<Number>(number);
  }

 private:
  std::span<const std::uint8_t> bytes_;
  std::size_t position_ = 0;
};

tl::unexpected<Error> malformed(const std::string& what) {
  return failure(Fault::kProtocol, "trigger box: " + what);
}

std::string wrong_size(const char* what, std::size_t size, std::size_t expected) {
  return std::string(what) + " of " + std::to_string(size) + " bytes instead of " +
         std::to_string(expected);
}

// What a box must refuse; empty when nothing.
std::string problem_of(const Config& config) {
  if (config.version != kProtocolVersion) {
    return "configuration of version " + std::to_string(config.version);
  }
  const auto edges = static_cast<std::uint8_t>(config.edges);
  if (edges < 1 || edges > 3) return "edge mask " + std::to_string(edges);
  if (config.pulse_count < 1 || config.pulse_count > kPulseLimit) {
    return std::to_string(config.pulse_count) + " pulses instead of 1 to 8";
  }
  for (std::size_t i = 0; i < config.width_us.size(); ++i) {
    if (i < config.pulse_count && config.width_us[i] == 0) return "a pulse without width";
    if (i >= config.pulse_count && config.width_us[i] != 0) return "a width without pulse";
  }
  if (config.threshold_low >= config.threshold_high || config.threshold_high > kAdcMax) {
    return "thresholds " + std::to_string(config.threshold_low) + " and " +
           std::to_string(config.threshold_high) + " ADC counts (0 <= low < high <= 1023)";
  }
  return {};
}

}  // namespace

std::uint16_t crc16(std::span<const std::uint8_t> bytes) {
  unsigned crc = 0xFFFF;
  for (const std::uint8_t byte : bytes) {
    crc ^= static_cast<unsigned>(byte) << 8;
    for (int bit = 0; bit < 8; ++bit) {
      crc = (crc & 0x8000) != 0 ? (crc << 1) ^ 0x1021 : crc << 1;
    }
    crc &= 0xFFFF;
  }
  return static_cast<std::uint16_t>(crc);
}

std::array<std::uint8_t, kRecordBytes> encode(const Record& record) {
  return Writer<kRecordBytes>()
      .put(static_cast<std::uint8_t>(record.type))
      .put(record.level)
      .put(record.pulse_index)
      .put(record.seq)
      .put(record.edge_number)
      .put(record.pulse_number)
      .put(record.time_us)
      .put(record.run_id)
      .put(record.dropped_count)
      .finish();
}

Result<Record> decode_record(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kRecordBytes) {
    return malformed(wrong_size("record", bytes.size(), kRecordBytes));
  }
  Reader reader(bytes);
  Record record;
  const auto type = reader.take<std::uint8_t>();
  if (type < static_cast<std::uint8_t>(RecordType::kArmed) ||
      type > static_cast<std::uint8_t>(RecordType::kFault)) {
    return malformed("record of unknown type " + std::to_string(type));
  }
  record.type = static_cast<RecordType>(type);
  record.level = reader.take<std::uint8_t>();
  if (record.level > 1) return malformed("record of level " + std::to_string(record.level));
  record.pulse_index = reader.take<std::uint16_t>();
  record.seq = reader.take<std::uint32_t>();
  record.edge_number = reader.take<std::uint32_t>();
  record.pulse_number = reader.take<std::uint32_t>();
  record.time_us = reader.take<std::uint64_t>();
  if (record.time_us > kTimeLimit_us) {
    return malformed("record of time " + std::to_string(record.time_us) + " us");
  }
  record.run_id = reader.take<std::uint32_t>();
  record.dropped_count = reader.take<std::uint32_t>();
  const bool is_pulse =
      record.type == RecordType::kPulseStart || record.type == RecordType::kPulseEnd;
  if (is_pulse && record.pulse_index >= kPulseLimit) {
    return malformed("record of pulse " + std::to_string(record.pulse_index));
  }
  return record;
}

Result<std::vector<Record>> decode_records(std::span<const std::uint8_t> bytes) {
  if (bytes.size() % kRecordBytes != 0) {
    return malformed("transfer of " + std::to_string(bytes.size()) +
                     " bytes, no multiple of a record's 32");
  }
  std::vector<Record> records;
  records.reserve(bytes.size() / kRecordBytes);
  for (; !bytes.empty(); bytes = bytes.subspan(kRecordBytes)) {
    const Result<Record> record = decode_record(bytes.first(kRecordBytes));
    if (!record) return tl::unexpected(record.error());
    records.push_back(*record);
  }
  return records;
}

std::array<std::uint8_t, kInfoBytes> encode(const Info& info) {
  return Writer<kInfoBytes>()
      .put(info.protocol_version)
      .put(info.firmware_version)
      .put(info.capabilities)
      .put(info.tick_hz)
      .finish();
}

Result<Info> decode_info(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kInfoBytes) return malformed(wrong_size("info", bytes.size(), kInfoBytes));
  Reader reader(bytes);
  Info info;
  info.protocol_version = reader.take<std::uint16_t>();
  info.firmware_version = reader.take<std::uint16_t>();
  info.capabilities = reader.take<std::uint32_t>();
  info.tick_hz = reader.take<std::uint32_t>();
  return info;
}

std::array<std::uint8_t, kConfigBytes> encode(const Config& config) {
  Writer<kConfigBytes> writer;
  writer.put(config.version)
      .put(static_cast<std::uint8_t>(config.edges))
      .put(config.pulse_count)
      .put(config.delay_rise_us)
      .put(config.delay_fall_us);
  for (const std::uint32_t width_us : config.width_us) writer.put(width_us);
  writer.put(config.gap_us)
      .put(config.debounce_us)
      .put(config.threshold_high)
      .put(config.threshold_low)
      .put(std::uint16_t{0});
  writer.put(crc16(writer.written()));
  return writer.finish();
}

Result<Config> decode_config(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kConfigBytes) {
    return malformed(wrong_size("configuration", bytes.size(), kConfigBytes));
  }
  Reader reader(bytes);
  Config config;
  config.version = reader.take<std::uint16_t>();
  config.edges = static_cast<Edges>(reader.take<std::uint8_t>());
  config.pulse_count = reader.take<std::uint8_t>();
  config.delay_rise_us = reader.take<std::uint32_t>();
  config.delay_fall_us = reader.take<std::uint32_t>();
  for (std::uint32_t& width_us : config.width_us) width_us = reader.take<std::uint32_t>();
  config.gap_us = reader.take<std::uint32_t>();
  config.debounce_us = reader.take<std::uint32_t>();
  config.threshold_high = reader.take<std::uint16_t>();
  config.threshold_low = reader.take<std::uint16_t>();
  const auto flags = reader.take<std::uint16_t>();
  const auto crc = reader.take<std::uint16_t>();
  if (crc != crc16(bytes.first(kConfigBytes - 2))) return malformed("configuration of wrong CRC");
  if (flags != 0) return malformed("configuration with unknown flags");
  if (const std::string problem = problem_of(config); !problem.empty()) return malformed(problem);
  return config;
}

Result<Config> make_config(const TriggerSettings& settings,
                           const std::vector<std::chrono::microseconds>& pulse_widths) {
  const auto out_of_range = [](const std::string& what) {
    return failure(Fault::kOutOfRange, "trigger box: " + what);
  };
  if (pulse_widths.empty() || pulse_widths.size() > kPulseLimit) {
    return out_of_range(std::to_string(pulse_widths.size()) + " pulses an edge instead of 1 to 8");
  }
  bool does_fit = true;
  const auto to_us = [&does_fit](std::chrono::microseconds duration) {
    does_fit = does_fit && duration.count() >= 0 &&
               duration.count() <= std::numeric_limits<std::uint32_t>::max();
    return static_cast<std::uint32_t>(duration.count());
  };
  Config config;
  config.pulse_count = static_cast<std::uint8_t>(pulse_widths.size());
  config.delay_rise_us = to_us(settings.delay_rise);
  config.delay_fall_us = to_us(settings.delay_fall);
  std::transform(pulse_widths.begin(), pulse_widths.end(), config.width_us.begin(), to_us);
  config.gap_us = to_us(settings.gap);
  config.debounce_us = to_us(settings.debounce);
  config.threshold_high = settings.threshold_high;
  config.threshold_low = settings.threshold_low;
  if (!does_fit) return out_of_range("a delay, width, gap or debounce time beyond 0 to 4294 s");
  if (const std::string problem = problem_of(config); !problem.empty()) {
    return out_of_range(problem);
  }
  return config;
}

std::array<std::uint8_t, kStatusBytes> encode(const Status& status) {
  return Writer<kStatusBytes>()
      .put(status.run_id)
      .put(status.edge_count)
      .put(status.pulse_count)
      .put(status.ignored_edge_count)
      .put(status.dropped_record_count)
      .put(std::uint32_t{status.is_armed ? 1u : 0u})
      .finish();
}

Result<Status> decode_status(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kStatusBytes) {
    return malformed(wrong_size("status", bytes.size(), kStatusBytes));
  }
  Reader reader(bytes);
  Status status;
  status.run_id = reader.take<std::uint32_t>();
  status.edge_count = reader.take<std::uint32_t>();
  status.pulse_count = reader.take<std::uint32_t>();
  status.ignored_edge_count = reader.take<std::uint32_t>();
  status.dropped_record_count = reader.take<std::uint32_t>();
  const auto armed = reader.take<std::uint32_t>();
  if (armed > 1) return malformed("status that is neither armed nor disarmed");
  status.is_armed = armed == 1;
  return status;
}

std::array<std::uint8_t, kLevelsBytes> encode(const Levels& levels) {
  return Writer<kLevelsBytes>().put(levels.minimum_adc).put(levels.maximum_adc).finish();
}

Result<Levels> decode_levels(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kLevelsBytes) {
    return malformed(wrong_size("levels", bytes.size(), kLevelsBytes));
  }
  Reader reader(bytes);
  Levels levels;
  levels.minimum_adc = reader.take<std::uint16_t>();
  levels.maximum_adc = reader.take<std::uint16_t>();
  if (levels.minimum_adc > levels.maximum_adc || levels.maximum_adc > kAdcMax) {
    return malformed("photodiode levels " + std::to_string(levels.minimum_adc) + " to " +
                     std::to_string(levels.maximum_adc));
  }
  return levels;
}

std::array<std::uint8_t, kTimeBytes> encode_time(std::uint64_t time_us) {
  return Writer<kTimeBytes>().put(time_us).finish();
}

Result<std::uint64_t> decode_time(std::span<const std::uint8_t> bytes) {
  if (bytes.size() != kTimeBytes) return malformed(wrong_size("time", bytes.size(), kTimeBytes));
  const auto time_us = Reader(bytes).take<std::uint64_t>();
  if (time_us > kTimeLimit_us) return malformed("time " + std::to_string(time_us) + " us");
  return time_us;
}

std::vector<Event> RecordReader::read(const Record& record, const ClockMap<BoxClock>& clock) {
  std::vector<Event> events;
  if (record.run_id != run_id_) return events;
  check_sequence(record, events);
  switch (record.type) {
    case RecordType::kEdge:
      events.push_back(EdgeSeen{record.edge_number, record.level == 1,
                                clock.to_host(to_time_point(record.time_us))});
      break;
    case RecordType::kIgnoredEdge:
      events.push_back(EdgeIgnored{record.edge_number, record.level == 1,
                                   clock.to_host(to_time_point(record.time_us))});
      break;
    case RecordType::kPulseStart:
      started_ = record;
      may_lack_start_ = false;
      break;
    case RecordType::kPulseEnd:
      end_pulse(record, clock, events);
      break;
    case RecordType::kFault:
      events.push_back(
          DeviceFault{Device::kTrigger,
                      {Fault::kDeviceLost, "the trigger box reports its own fault " +
                                               std::to_string(record.pulse_index) +
                                               ": unplug it, plug it in again, and open it anew"}});
      break;
    case RecordType::kArmed:
    case RecordType::kHeartbeat:
    case RecordType::kOverflow:  // check_sequence() has reported it
    case RecordType::kDisarmed:
      break;
  }
  return events;
}

void RecordReader::check_sequence(const Record& record, std::vector<Event>& events) {
  // Between runs the heart beats on under the last run's id, which may be this one's.
  if (!has_begun_ && record.type == RecordType::kHeartbeat) return;
  has_begun_ = true;
  const std::uint32_t expected = std::exchange(next_seq_, record.seq + 1);
  if (record.seq == expected && record.type != RecordType::kOverflow) return;
  may_lack_start_ = !started_;
  const std::string lost = record.type == RecordType::kOverflow
                               ? "the trigger box dropped " + std::to_string(record.dropped_count) +
                                     " records because this computer did not read them in time"
                               : "trigger box record " + std::to_string(record.seq) +
                                     " came instead of " + std::to_string(expected) +
                                     ": records were lost";
  events.push_back(DeviceFault{Device::kTrigger, {Fault::kSequenceGap, lost}});
}

void RecordReader::end_pulse(const Record& record, const ClockMap<BoxClock>& clock,
                             std::vector<Event>& events) {
  const std::optional<Record> start = std::exchange(started_, std::nullopt);
  if (start && start->pulse_number == record.pulse_number) {
    events.push_back(PulseEnded{record.edge_number, record.pulse_index, record.pulse_number,
                                clock.to_host(to_time_point(start->time_us)),
                                clock.to_host(to_time_point(record.time_us))});
  } else if (!may_lack_start_) {
    events.push_back(
        DeviceFault{Device::kTrigger,
                    {Fault::kProtocol, "trigger box: pulse " + std::to_string(record.pulse_number) +
                                           " ended without having started"}});
  }
  may_lack_start_ = false;
}

}  // namespace rig::tb1
