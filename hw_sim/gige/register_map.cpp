#include "hw_sim/gige/register_map.h"

#include <arpa/inet.h>

#include <algorithm>
#include <bit>
#include <cstdio>
#include <cstring>

#include "hw_sim/exposure_engine.h"
#include "hw_sim/gige/big_endian.h"
#include "hw_sim/gige/pixel_format.h"

namespace hw_sim {
namespace {

using Kind = Register::Kind;
using Access = Register::Access;
using Entries = std::vector<std::pair<std::string, std::uint32_t>>;

constexpr std::uint32_t value_of(auto enumerator) { return static_cast<std::uint32_t>(enumerator); }

Register hidden(std::uint32_t address, std::uint32_t length_bytes, Access access) {
  return {.address = address, .access = access, .length_bytes = length_bytes};
}

Register text(std::uint32_t address, std::string_view name, std::uint32_t length_bytes,
              Access access) {
  return {.address = address,
          .name = name,
          .kind = Kind::kText,
          .access = access,
          .category = "DeviceControl",
          .length_bytes = length_bytes};
}

Register readable(std::uint32_t address, std::string_view name, std::string_view category,
                  std::uint32_t length_bytes = 4) {
  return {.address = address,
          .name = name,
          .kind = Kind::kInteger,
          .access = Access::kReadOnly,
          .category = category,
          .length_bytes = length_bytes};
}

Register command(std::uint32_t address, std::string_view name, std::string_view category) {
  return {.address = address,
          .name = name,
          .kind = Kind::kCommand,
          .access = Access::kWriteOnly,
          .category = category};
}

Register enumeration(std::uint32_t address, std::string_view name, std::string_view category,
                     Entries entries, std::vector<std::string_view> selected = {}) {
  return {.address = address,
          .name = name,
          .kind = Kind::kEnumeration,
          .category = category,
          .entries = std::move(entries),
          .selected = std::move(selected)};
}

Register extent(std::uint32_t address, std::string_view name, std::int64_t min,
                std::string_view max_feature) {
  return {.address = address,
          .name = name,
          .kind = Kind::kInteger,
          .category = "ImageFormatControl",
          .min = min,
          .max_feature = max_feature,
          .unit = "px",
          .is_locked_while_acquiring = true};
}

Register set_number(std::uint32_t address, std::string_view name,
                    std::vector<std::string_view> selected = {}) {
  return {.address = address,
          .name = name,
          .kind = Kind::kInteger,
          .category = "SequencerControl",
          .max = ExposureEngine::kSetCount - 1,
          .selected = std::move(selected)};
}

Entries format_entries(const std::vector<std::string>& names) {
  Entries entries;
  for (const std::string& name : names)
    if (const auto format = find_pixel_format(name)) entries.emplace_back(name, format->code);
  return entries;
}

Entries activation_entries(const DeviceDescription& description) {
  Entries entries{{"RisingEdge", value_of(TriggerActivation::kRisingEdge)}};
  if (description.has_any_edge)
    entries.emplace_back("AnyEdge", value_of(TriggerActivation::kAnyEdge));
  return entries;
}

Entries chunk_entries(const DeviceDescription& description) {
  Entries entries{{"Image", value_of(Chunk::kImage)},
                  {"ExposureTime", value_of(Chunk::kExposureTime)},
                  {"FrameID", value_of(Chunk::kFrameId)},
                  {"CounterValue", value_of(Chunk::kCounterValue)},
                  {"SequencerSetActive", value_of(Chunk::kSequencerSetActive)},
                  {"Timestamp", value_of(Chunk::kTimestamp)}};
  if (description.has_line_status)
    entries.emplace_back("LineStatusAll", value_of(Chunk::kLineStatusAll));
  return entries;
}

Register time_us(std::uint32_t address, std::string_view name, std::string_view category,
                 std::int64_t max, bool is_integer) {
  return {.address = address,
          .name = name,
          .kind = is_integer ? Kind::kInteger : Kind::kFloat,
          .category = category,
          .max = max,
          .unit = "us"};
}

Register locked(Register row) {
  row.is_locked_while_acquiring = true;
  return row;
}

std::vector<Register> bootstrap_registers() {
  using enum Register::Access;
  return {
      hidden(kVersion, 0x18, kReadOnly),
      hidden(kCurrentAddress, 4, kReadOnly),
      hidden(kSubnetMask, 4, kReadOnly),
      text(kVendorName, "DeviceVendorName", 32, kReadOnly),
      text(kModelName, "DeviceModelName", 32, kReadOnly),
      text(kDeviceVersion, "DeviceVersion", 32, kReadOnly),
      text(kManufacturerInfo, "DeviceManufacturerInfo", 48, kReadOnly),
      text(kSerialNumber, "DeviceSerialNumber", 16, kReadOnly),
      text(kUserName, "DeviceUserID", 16, kReadWrite),
      hidden(kXmlUrl, 512, kReadOnly),
      hidden(kSecondXmlUrl, 512, kReadOnly),
      hidden(kInterfaceCount, 4, kReadOnly),
      hidden(kMessageChannelCount, 4, kReadOnly),
      readable(kStreamChannelCount, "GevStreamChannelCount", "TransportLayerControl"),
      hidden(kControlCapability, 4, kReadOnly),
      {.address = kHeartbeatTimeout,
       .name = "GevHeartbeatTimeout",
       .kind = Kind::kInteger,
       .category = "TransportLayerControl",
       .min = 500,
       .max = 600'000,
       .unit = "ms"},
      readable(kTimestampFrequency, "GevTimestampTickFrequency", "TransportLayerControl", 8),
      command(kTimestampControl, "GevTimestampControlLatch", "TransportLayerControl"),
      readable(kTimestampLatched, "GevTimestampValue", "TransportLayerControl", 8),
      enumeration(kControlPrivilege, "GevCCP", "TransportLayerControl",
                  {{"OpenAccess", 0}, {"ExclusiveAccess", 1}, {"ControlAccess", 2}}),
      hidden(kPrimaryPort, 4, kReadOnly),
      readable(kPrimaryAddress, "GevPrimaryApplicationIPAddress", "TransportLayerControl"),
      {.address = kStreamPort,
       .name = "GevSCPHostPort",
       .kind = Kind::kInteger,
       .category = "TransportLayerControl",
       .max = 0xFFFF},
      hidden(kStreamPacketSize, 4, kReadWrite),
      {.address = kStreamPacketDelay,
       .name = "GevSCPD",
       .kind = Kind::kInteger,
       .category = "TransportLayerControl"},
      {.address = kStreamAddress,
       .name = "GevSCDA",
       .kind = Kind::kInteger,
       .category = "TransportLayerControl"},
      readable(kStreamSourcePort, "GevSCSP", "TransportLayerControl"),
  };
}

std::vector<Register> imaging_registers(const DeviceDescription& description) {
  return {
      readable(kSensorWidth, "WidthMax", "ImageFormatControl"),
      readable(kSensorHeight, "HeightMax", "ImageFormatControl"),
      extent(kWidth, "Width", 1, "WidthMax"),
      extent(kHeight, "Height", 1, "HeightMax"),
      extent(kOffsetX, "OffsetX", 0, "WidthMax"),
      extent(kOffsetY, "OffsetY", 0, "HeightMax"),
      locked(enumeration(kPixelFormat, "PixelFormat", "ImageFormatControl",
                         format_entries(description.pixel_formats))),
      readable(kPayloadSize, "PayloadSize", "TransportLayerControl"),
      enumeration(kAcquisitionMode, "AcquisitionMode", "AcquisitionControl", {{"Continuous", 0}}),
      command(kAcquisitionStart, "AcquisitionStart", "AcquisitionControl"),
      command(kAcquisitionStop, "AcquisitionStop", "AcquisitionControl"),
      {.address = kParamsLocked,
       .name = "TLParamsLocked",
       .kind = Kind::kInteger,
       .category = "TransportLayerControl",
       .max = 1},
      enumeration(
          kTriggerSelector, "TriggerSelector", "AcquisitionControl", {{"FrameStart", 0}},
          {"TriggerMode", "TriggerSource", "TriggerActivation", "TriggerSoftware", "TriggerDelay"}),
      enumeration(kTriggerMode, "TriggerMode", "AcquisitionControl", {{"Off", 0}, {"On", 1}}),
      enumeration(kTriggerSource, "TriggerSource", "AcquisitionControl",
                  {{"Software", value_of(TriggerSource::kSoftware)},
                   {"Line1", value_of(TriggerSource::kLine1)}}),
      enumeration(kTriggerActivation, "TriggerActivation", "AcquisitionControl",
                  activation_entries(description)),
      command(kTriggerSoftware, "TriggerSoftware", "AcquisitionControl"),
      time_us(kTriggerDelay, "TriggerDelay", "AcquisitionControl", 1'000'000,
              description.variant.has_integer_times),
      readable(kTriggerMissedCount, "TriggerMissedCount", "AcquisitionControl"),
      enumeration(kExposureMode, "ExposureMode", "AcquisitionControl",
                  {{"Timed", value_of(ExposureMode::kTimed)},
                   {"TriggerWidth", value_of(ExposureMode::kTriggerWidth)}}),
      {.address = kExposureTime,
       .name = "ExposureTime",
       .kind = Kind::kFloat,
       .category = "AcquisitionControl",
       .min = static_cast<std::int64_t>(kExposureMinUs),
       .max = static_cast<std::int64_t>(kExposureMaxUs),
       .unit = "us"},
      enumeration(kExposureAuto, "ExposureAuto", "AcquisitionControl", {{"Off", 0}}),
      {.address = kGain,
       .name = "Gain",
       .kind = Kind::kFloat,
       .category = "AnalogControl",
       .max = 24,
       .unit = "dB"},
      {.address = kBlackLevel,
       .name = "BlackLevel",
       .kind = Kind::kFloat,
       .category = "AnalogControl",
       .max = 4095,
       .unit = "DN"},
      enumeration(kBalanceWhiteAuto, "BalanceWhiteAuto", "AnalogControl",
                  {{"Off", 0}, {"Continuous", 1}}),
      enumeration(kBalanceRatioSelector, "BalanceRatioSelector", "AnalogControl",
                  {{"Red", 0}, {"Green", 1}, {"Blue", 2}}, {"BalanceRatio"}),
      {.address = kBalanceRatio,
       .name = "BalanceRatio",
       .kind = Kind::kFloat,
       .category = "AnalogControl",
       .max = 16},
  };
}

std::vector<Register> sequencer_and_data_registers(const DeviceDescription& description) {
  return {
      locked({.address = kChunkModeActive,
              .name = "ChunkModeActive",
              .kind = Kind::kBoolean,
              .category = "ChunkDataControl",
              .max = 1}),
      enumeration(kChunkSelector, "ChunkSelector", "ChunkDataControl", chunk_entries(description),
                  {"ChunkEnable"}),
      locked({.address = kChunkEnable,
              .name = "ChunkEnable",
              .kind = Kind::kBoolean,
              .category = "ChunkDataControl",
              .max = 1}),
      enumeration(kSequencerMode, "SequencerMode", "SequencerControl", {{"Off", 0}, {"On", 1}}),
      enumeration(kSequencerConfigurationMode, "SequencerConfigurationMode", "SequencerControl",
                  {{"Off", 0}, {"On", 1}}),
      set_number(kSequencerSetSelector, "SequencerSetSelector",
                 {"SequencerSetSave", "SequencerSetLoad", "SequencerPathSelector",
                  "SequencerSetNext", "SequencerTriggerSource"}),
      command(kSequencerSetSave, "SequencerSetSave", "SequencerControl"),
      command(kSequencerSetLoad, "SequencerSetLoad", "SequencerControl"),
      readable(kSequencerSetActive, "SequencerSetActive", "SequencerControl"),
      set_number(kSequencerSetStart, "SequencerSetStart"),
      {.address = kSequencerPathSelector,
       .name = "SequencerPathSelector",
       .kind = Kind::kInteger,
       .category = "SequencerControl",
       .max = 0,
       .selected = {"SequencerSetNext", "SequencerTriggerSource"}},
      set_number(kSequencerSetNext, "SequencerSetNext"),
      enumeration(kSequencerTriggerSource, "SequencerTriggerSource", "SequencerControl",
                  {{"Off", value_of(SequencerTrigger::kOff)},
                   {"FrameStart", value_of(SequencerTrigger::kFrameStart)}}),
      enumeration(kCounterSelector, "CounterSelector", "CounterAndTimerControl",
                  {{"Counter0", value_of(Counter::kTriggers)},
                   {"Counter1", value_of(Counter::kMissedTriggers)}},
                  {"CounterEventSource", "CounterValue", "CounterReset"}),
      // Wired: Counter0 counts pulses on the trigger line, Counter1 those the camera missed.
      {.address = kCounterEventSource,
       .name = "CounterEventSource",
       .kind = Kind::kEnumeration,
       .access = Access::kReadOnly,
       .category = "CounterAndTimerControl",
       .entries = {{"FrameTrigger", value_of(Counter::kTriggers)},
                   {"FrameTriggerMissed", value_of(Counter::kMissedTriggers)}}},
      readable(kCounterValue, "CounterValue", "CounterAndTimerControl"),
      command(kCounterReset, "CounterReset", "CounterAndTimerControl"),
  };
}

std::vector<Register> line_registers(const DeviceDescription& description) {
  // Of Line1 alone: nothing is ever plugged into Line0.
  std::vector<Register> rows{{.address = kLineInverter,
                              .name = "LineInverter",
                              .kind = Kind::kBoolean,
                              .category = "DigitalIOControl",
                              .max = 1}};
  if (description.has_debouncer)
    rows.push_back(time_us(kLineDebouncerTime, "LineDebouncerTime", "DigitalIOControl", 20'000,
                           description.variant.has_integer_times));
  if (!description.variant.has_line_selector) return rows;
  std::vector<std::string_view> selected;
  selected.reserve(rows.size());
  for (const Register& row : rows) selected.push_back(row.name);
  rows.push_back(enumeration(kLineSelector, "LineSelector", "DigitalIOControl",
                             {{"Line0", value_of(Line::kLine0)}, {"Line1", value_of(Line::kLine1)}},
                             std::move(selected)));
  return rows;
}

std::vector<Register> make_table(const DeviceDescription& description) {
  std::vector<Register> table = bootstrap_registers();
  for (auto&& rows : {imaging_registers(description), sequencer_and_data_registers(description),
                      line_registers(description)})
    table.insert(table.end(), rows.begin(), rows.end());
  const auto is_among = [](const std::vector<std::string>& names, const Register& row) {
    return std::find(names.begin(), names.end(), row.name) != names.end();
  };
  for (Register& row : table) {
    if (is_among(description.variant.fixed_features, row)) row.access = Access::kReadOnly;
    row.is_refused = is_among(description.variant.refused_features, row);
  }
  return table;
}

bool is_value_allowed(const Register& row, std::uint32_t value) {
  switch (row.kind) {
    case Kind::kEnumeration:
      return std::any_of(row.entries.begin(), row.entries.end(),
                         [&](const auto& entry) { return entry.second == value; });
    case Kind::kFloat: {
      const auto number = std::bit_cast<float>(value);
      return number >= static_cast<float>(row.min) && number <= static_cast<float>(row.max);
    }
    case Kind::kInteger:
    case Kind::kBoolean:
      return value >= row.min && value <= row.max;
    default:
      return true;
  }
}

}  // namespace

RegisterMap::RegisterMap(const DeviceDescription& description)
    : table_(make_table(description)), memory_(kXmlStart), xml_(make_genicam_xml(table_)) {
  const std::size_t xml_bytes = xml_.size();
  xml_.resize((xml_bytes + 3) / 4 * 4);
  char url[64];
  std::snprintf(url, sizeof url, "Local:ssrig_sim.xml;%X;%zX", value_of(kXmlStart), xml_bytes);

  in_addr address{};
  inet_pton(AF_INET, description.address.c_str(), &address);
  set(kVersion, 0x00020000);     // GigE Vision 2.0
  set(kDeviceMode, 0x80000001);  // big-endian, UTF-8
  // A locally administered MAC address, unlike those of other simulated cameras.
  set(kMacHigh, 0x0000024E);
  set(kMacLow, ntohl(address.s_addr));
  set(kInterfaceCapability, 7);
  set(kInterfaceConfiguration, 4);
  set(kCurrentAddress, ntohl(address.s_addr));
  set(kSubnetMask, 0xFF000000);
  set_text(kVendorName, "ssrig");
  set_text(kModelName, "SimulatedCamera");
  set_text(kDeviceVersion, "1.0");
  set_text(kManufacturerInfo, "GigE Vision camera of ssrig-sim");
  set_text(kSerialNumber, description.serial);
  set_text(kXmlUrl, url);
  set(kInterfaceCount, 1);
  set(kStreamChannelCount, 1);
  set(kControlCapability, 0xC0000006);  // user name, serial, packet resend, WRITEMEM
  set(kHeartbeatTimeout, 3000);
  set64(kTimestampFrequency, 1'000'000'000);
  set(kStreamPacketSize, 1500);

  set(kSensorWidth, static_cast<std::uint32_t>(description.width_px));
  set(kSensorHeight, static_cast<std::uint32_t>(description.height_px));
  set(kWidth, get(kSensorWidth));
  set(kHeight, get(kSensorHeight));
  if (const auto format = find_pixel_format(std::string_view(description.pixel_formats.front())))
    set(kPixelFormat, format->code);
  set_float(kExposureTime, 10'000);
  set_float(kGain, description.variant.gain_db);
  set_float(kBlackLevel, description.variant.black_level_dn);
  if (description.has_debouncer)
    set_time_us(kLineDebouncerTime, description.variant.line_debounce_us);
  if (is_writable(kTriggerDelay)) set_time_us(kTriggerDelay, kLeftTriggerDelay_us);
  if (is_writable(kLineInverter)) set(kLineInverter, 1);
  set(kChunkEnable, 1);  // ChunkSelector stands at Image, which is always on
}

std::uint32_t RegisterMap::get(std::uint32_t address) const { return get32(&memory_[address]); }
void RegisterMap::set(std::uint32_t address, std::uint32_t value) {
  put32(&memory_[address], value);
}
void RegisterMap::set64(std::uint32_t address, std::uint64_t value) {
  put64(&memory_[address], value);
}
float RegisterMap::get_float(std::uint32_t address) const {
  return std::bit_cast<float>(get(address));
}
void RegisterMap::set_float(std::uint32_t address, float value) {
  set(address, std::bit_cast<std::uint32_t>(value));
}

float RegisterMap::get_time_us(std::uint32_t address) const {
  const Register* row = find(address);
  return row != nullptr && row->kind == Kind::kInteger ? static_cast<float>(get(address))
                                                       : get_float(address);
}
void RegisterMap::set_time_us(std::uint32_t address, float time_us) {
  if (find(address)->kind == Kind::kInteger)
    set(address, static_cast<std::uint32_t>(time_us));
  else
    set_float(address, time_us);
}

void RegisterMap::set_text(std::uint32_t address, std::string_view text_value) {
  const std::size_t room = find(address)->length_bytes - 1;  // the terminating zero stays
  std::copy_n(text_value.begin(), std::min(room, text_value.size()), &memory_[address]);
}

const Register* RegisterMap::find(std::uint32_t address) const {
  for (const Register& row : table_)
    if (address >= row.address && address < row.address + row.length_bytes) return &row;
  return nullptr;
}

bool RegisterMap::is_writable(std::uint32_t address) const {
  const Register* row = find(address);
  return row != nullptr && row->access != Access::kReadOnly;
}

bool RegisterMap::is_readable(std::uint32_t address) const {
  if (address >= kXmlStart) return address - kXmlStart < xml_.size();
  // Discovery reads the bootstrap block in one piece, its reserved words included.
  if (address < kXmlUrl) return true;
  const Register* row = find(address);
  return row != nullptr && !row->is_refused;
}

GvcpStatus RegisterMap::read(std::uint32_t address, std::span<std::uint8_t> bytes) const {
  if (address % 4 != 0 || bytes.size() % 4 != 0) return GvcpStatus::kBadAlignment;
  for (std::size_t i = 0; i < bytes.size(); i += 4) {
    const auto word = static_cast<std::uint32_t>(address + i);
    if (!is_readable(word)) return GvcpStatus::kInvalidAddress;
    const void* from =
        word >= kXmlStart ? static_cast<const void*>(&xml_[word - kXmlStart]) : &memory_[word];
    std::memcpy(&bytes[i], from, 4);
  }
  return GvcpStatus::kSuccess;
}

GvcpStatus RegisterMap::check_write(std::uint32_t address, std::uint32_t value) const {
  if (address % 4 != 0) return GvcpStatus::kBadAlignment;
  const Register* row = find(address);
  if (row == nullptr) return GvcpStatus::kInvalidAddress;
  if (row->access == Access::kReadOnly) return GvcpStatus::kWriteProtected;
  if (row->is_locked_while_acquiring && get(kParamsLocked) != 0) return GvcpStatus::kAccessDenied;
  return is_value_allowed(*row, value) ? GvcpStatus::kSuccess : GvcpStatus::kInvalidParameter;
}

}  // namespace hw_sim
