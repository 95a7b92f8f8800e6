// TB1, the trigger box's wire protocol, version 1: plain structs and their little-endian bytes.
// A USB 2.0 full-speed device of vendor class 0xFF with one interface, one bulk IN endpoint that
// carries records, and vendor requests to the device on endpoint 0. No libusb here:
// rig/devices/libusb_trigger.h speaks it, hw_sim/trigger_box_model.h answers it.
//
// Decoding trusts nothing: every decode_*() checks length, type and range and returns kProtocol.
// All functions are thread-safe.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "rig/event.h"
#include "rig/fault.h"
#include "rig/trigger.h"

namespace rig::tb1 {

constexpr std::uint16_t kProtocolVersion = 1;
constexpr std::uint8_t kEndpointIn = 0x81;
constexpr std::size_t kPacketBytes = 64;
constexpr std::chrono::milliseconds kHeartbeatPeriod{100};
constexpr int kPulseLimit = 8;
constexpr int kAdcMax = 1023;  // 10-bit photodiode levels

// ---- Records: device to host, 32 bytes each, two a packet. A short packet flushes: a burst that
// ends on a full packet is followed by an empty one, as bulk transfers require. ----

enum class RecordType : std::uint8_t {
  kArmed = 1,        // first record of a run: seq 0
  kEdge = 2,         // answered edge
  kPulseStart = 3,   // the camera's line went up
  kPulseEnd = 4,     // and down
  kIgnoredEdge = 5,  // during a train of pulses or within the debounce time of another edge
  kHeartbeat = 6,    // every 100 ms from power-up, armed or not
  kOverflow = 7,     // the host did not read: `dropped` records of this run are missing so far
  kDisarmed = 8,     // last record of a run, with its totals
  kFault = 9         // the box found itself broken; pulse_index is its code
};

struct Record {
  RecordType type = RecordType::kHeartbeat;
  std::uint8_t level = 0;          // light (1) or dark (0) after the edge; now, in other types
  std::uint16_t pulse_index = 0;   // bracket 0..7; ignored edges so far in kDisarmed
  std::uint32_t seq = 0;           // counts every record of the run from 0, dropped ones too
  std::uint32_t edge_number = 0;   // answered edges so far, this one included: 1, 2, ...
  std::uint32_t pulse_number = 0;  // pulses so far, this one included: 1, 2, ...
  std::uint64_t time_us = 0;       // box clock, at the edge or the pulse's flank
  std::uint32_t run_id = 0;        // 16 bits of it travel in ARM; 0 before the first
  std::uint32_t dropped_count = 0;

  bool operator==(const Record&) const = default;
};

constexpr std::size_t kRecordBytes = 32;
std::array<std::uint8_t, kRecordBytes> encode(const Record& record);
Result<Record> decode_record(std::span<const std::uint8_t> bytes);
// A whole transfer: any number of records. A remainder that is no whole record is an error.
Result<std::vector<Record>> decode_records(std::span<const std::uint8_t> bytes);

// ---- Vendor requests: bmRequestType 0xC0 (in) or 0x40 (out); invalid ones STALL. ----

enum class Request : std::uint8_t {
  kGetInfo = 1,      // in: Info
  kSetConfig = 2,    // out: Config; STALL while armed or if anything in it is wrong
  kGetConfig = 3,    // in: Config; STALL before the first kSetConfig
  kArm = 4,          // wValue: run id; clears counters and queue, ends a run that is on; STALL
                     // without a configuration
  kDisarm = 5,       // no pulse starts afterwards; one that is up keeps its width. Always accepted
  kGetStatus = 6,    // in: Status
  kGetTime = 7,      // in: u64, box clock in us
  kSoftTrigger = 8,  // answers an edge that was not: same records, no delay; STALL unless armed
                     // and between trains
  kGetLevel = 9      // in: Levels since the last kGetLevel
};
constexpr std::uint8_t kRequestTypeIn = 0xC0;
constexpr std::uint8_t kRequestTypeOut = 0x40;

// u16 protocol_version, u16 firmware_version, u32 capabilities, u32 tick_hz.
struct Info {
  std::uint16_t protocol_version = kProtocolVersion;
  std::uint16_t firmware_version = 0;
  std::uint32_t capabilities = 0;  // none defined yet
  std::uint32_t tick_hz = 1'000'000;

  bool operator==(const Info&) const = default;
};
constexpr std::size_t kInfoBytes = 12;
std::array<std::uint8_t, kInfoBytes> encode(const Info& info);
Result<Info> decode_info(std::span<const std::uint8_t> bytes);  // any version: the caller decides

enum class Edges : std::uint8_t { kRise = 1, kFall = 2, kBoth = 3 };

// u16 version, u8 edges, u8 pulse_count, u32 delay_rise_us, u32 delay_fall_us, u32 width_us[8],
// u32 gap_us, u32 debounce_us, u16 threshold_high, u16 threshold_low, u16 flags (0), u16 crc
// (CRC-16/CCITT-FALSE of the 58 bytes before it).
struct Config {
  std::uint16_t version = kProtocolVersion;
  Edges edges = Edges::kBoth;
  std::uint8_t pulse_count = 1;
  std::uint32_t delay_rise_us = 0;
  std::uint32_t delay_fall_us = 0;
  std::array<std::uint32_t, kPulseLimit> width_us{};  // zero beyond pulse_count
  std::uint32_t gap_us = 0;
  std::uint32_t debounce_us = 0;
  std::uint16_t threshold_high = 600;
  std::uint16_t threshold_low = 400;

  bool operator==(const Config&) const = default;
};
constexpr std::size_t kConfigBytes = 60;
std::array<std::uint8_t, kConfigBytes> encode(const Config& config);
// Also refuses what a box must refuse: another version, 0 or 9 pulses, a pulse without width,
// thresholds that cross.
Result<Config> decode_config(std::span<const std::uint8_t> bytes);
// The configuration that a rig file asks for. Errors: kOutOfRange.
Result<Config> make_config(const TriggerSettings& settings,
                           const std::vector<std::chrono::microseconds>& pulse_widths);

// u32 run_id, u32 edge_count, u32 pulse_count, u32 ignored_edge_count, u32 dropped_record_count,
// u8 is_armed, 3 bytes zero.
struct Status {
  std::uint32_t run_id = 0;
  std::uint32_t edge_count = 0;
  std::uint32_t pulse_count = 0;
  std::uint32_t ignored_edge_count = 0;
  std::uint32_t dropped_record_count = 0;
  bool is_armed = false;

  bool operator==(const Status&) const = default;
};
constexpr std::size_t kStatusBytes = 24;
std::array<std::uint8_t, kStatusBytes> encode(const Status& status);
Result<Status> decode_status(std::span<const std::uint8_t> bytes);

// u16 minimum_adc, u16 maximum_adc.
struct Levels {
  std::uint16_t minimum_adc = 0;
  std::uint16_t maximum_adc = 0;

  bool operator==(const Levels&) const = default;
};
constexpr std::size_t kLevelsBytes = 4;
std::array<std::uint8_t, kLevelsBytes> encode(const Levels& levels);
Result<Levels> decode_levels(std::span<const std::uint8_t> bytes);

// Times beyond 292 years, which no time point holds, do not decode.
constexpr std::size_t kTimeBytes = 8;
std::array<std::uint8_t, kTimeBytes> encode_time(std::uint64_t time_us);
Result<std::uint64_t> decode_time(std::span<const std::uint8_t> bytes);
constexpr BoxClock::time_point to_time_point(std::uint64_t time_us) {
  return BoxClock::time_point(BoxClock::duration(static_cast<BoxClock::rep>(time_us)));
}

// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected; "123456789" gives 0x29B1.
std::uint16_t crc16(std::span<const std::uint8_t> bytes);

// What of a 32-bit run id the wire carries.
constexpr std::uint16_t wire_run_id(std::uint32_t run_id) {
  return static_cast<std::uint16_t>(run_id & 0xFFFF);
}

// Follows one run through its records and says what the session thread should hear. Not
// thread-safe.
class RecordReader {
 public:
  explicit RecordReader(std::uint32_t run_id) : run_id_(wire_run_id(run_id)) {}

  // Events of `record`, in order; none for records of another run. A gap in `seq`, kOverflow,
  // kFault and a pulse that ends without having started become DeviceFault{kTrigger}.
  std::vector<Event> read(const Record& record, const ClockMap<BoxClock>& clock);

 private:
  void check_sequence(const Record& record, std::vector<Event>& events);
  void end_pulse(const Record& record, const ClockMap<BoxClock>& clock, std::vector<Event>& events);

  std::uint32_t run_id_;
  bool has_begun_ = false;
  std::uint32_t next_seq_ = 0;
  std::optional<Record> started_;  // pulse that is up
  bool may_lack_start_ = false;    // a gap may have swallowed the start of the pulse that is up
};

}  // namespace rig::tb1
