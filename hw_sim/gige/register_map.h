// The simulated camera's registers: one table from which come the memory a client reads, the checks
// of what it writes, and the GenICam XML that names them (SFNC names).
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "hw_sim/gige/camera_variant.h"
#include "hw_sim/gige/gvcp.h"

namespace hw_sim {

// Addresses. Below 0xA000 they are the bootstrap registers of GigE Vision 2.0; the rest is ours.
enum RegisterAddress : std::uint32_t {
  kVersion = 0x0000,
  kDeviceMode = 0x0004,
  kMacHigh = 0x0008,
  kMacLow = 0x000C,
  kInterfaceCapability = 0x0010,
  kInterfaceConfiguration = 0x0014,
  kCurrentAddress = 0x0024,
  kSubnetMask = 0x0034,
  kVendorName = 0x0048,
  kModelName = 0x0068,
  kDeviceVersion = 0x0088,
  kManufacturerInfo = 0x00A8,
  kSerialNumber = 0x00D8,
  kUserName = 0x00E8,
  kXmlUrl = 0x0200,
  kSecondXmlUrl = 0x0400,
  kInterfaceCount = 0x0600,
  kMessageChannelCount = 0x0900,
  kStreamChannelCount = 0x0904,
  kControlCapability = 0x0934,
  kHeartbeatTimeout = 0x0938,
  kTimestampFrequency = 0x093C,  // 64 bit
  kTimestampControl = 0x0944,
  kTimestampLatched = 0x0948,  // 64 bit
  kControlPrivilege = 0x0A00,
  kPrimaryPort = 0x0A04,
  kPrimaryAddress = 0x0A14,
  kStreamPort = 0x0D00,
  kStreamPacketSize = 0x0D04,
  kStreamPacketDelay = 0x0D08,
  kStreamAddress = 0x0D18,
  kStreamSourcePort = 0x0D1C,

  kSensorWidth = 0xA000,
  kSensorHeight = 0xA004,
  kWidth = 0xA008,
  kHeight = 0xA00C,
  kOffsetX = 0xA010,
  kOffsetY = 0xA014,
  kPixelFormat = 0xA018,
  kPayloadSize = 0xA01C,
  kAcquisitionMode = 0xA020,
  kAcquisitionStart = 0xA024,
  kAcquisitionStop = 0xA028,
  kParamsLocked = 0xA02C,
  kTriggerSelector = 0xA030,
  kTriggerMode = 0xA034,
  kTriggerSource = 0xA038,
  kTriggerActivation = 0xA03C,
  kTriggerSoftware = 0xA040,
  kTriggerMissedCount = 0xA044,
  kExposureMode = 0xA048,
  kExposureTime = 0xA04C,
  kExposureAuto = 0xA050,
  kGain = 0xA054,
  kBlackLevel = 0xA058,
  kTriggerDelay = 0xA05C,
  kChunkModeActive = 0xA060,
  kChunkSelector = 0xA064,
  kChunkEnable = 0xA068,
  kSequencerMode = 0xA070,
  kSequencerConfigurationMode = 0xA074,
  kSequencerSetSelector = 0xA078,
  kSequencerSetSave = 0xA07C,
  kSequencerSetLoad = 0xA080,
  kSequencerSetActive = 0xA084,
  kSequencerSetStart = 0xA088,
  kSequencerPathSelector = 0xA08C,
  kSequencerSetNext = 0xA090,
  kSequencerTriggerSource = 0xA094,
  kCounterSelector = 0xA0A0,
  kCounterEventSource = 0xA0A4,
  kCounterValue = 0xA0A8,
  kCounterReset = 0xA0AC,
  kLineSelector = 0xA0B0,
  kLineDebouncerTime = 0xA0B4,
  kLineInverter = 0xA0B8,
  kBalanceWhiteAuto = 0xA0C0,
  kBalanceRatioSelector = 0xA0C4,
  kBalanceRatio = 0xA0C8,

  kXmlStart = 0x10000
};

// Values of enumerations, as written into their registers.
enum class TriggerSource : std::uint32_t { kSoftware = 0, kLine1 = 1 };
enum class Line : std::uint32_t { kLine0 = 0, kLine1 = 1 };  // and its bit in LineStatusAll
enum class TriggerActivation : std::uint32_t { kRisingEdge = 0, kAnyEdge = 1 };
enum class ExposureMode : std::uint32_t { kTimed = 0, kTriggerWidth = 1 };
enum class SequencerTrigger : std::uint32_t { kOff = 0, kFrameStart = 1 };
enum class Counter : std::uint32_t { kTriggers = 0, kMissedTriggers = 1 };
inline constexpr std::uint32_t kCounterCount = 2;

// Chunks: the value of ChunkSelector, and the chunk id on the wire less kFirstChunkId.
enum class Chunk : std::uint32_t {
  kImage,
  kExposureTime,
  kFrameId,
  kCounterValue,
  kSequencerSetActive,
  kTimestamp,
  kLineStatusAll
};
inline constexpr std::uint32_t kChunkCount = 7;
inline constexpr std::uint32_t kFirstChunkId = 0x1000;
inline constexpr std::uint32_t kImageChunkId = kFirstChunkId;
inline constexpr std::uint32_t kChunkBytes = 8;  // of each chunk but the image

inline constexpr std::uint32_t kPacketSizeMin = 220;  // IP and UDP headers included
inline constexpr std::uint32_t kPacketSizeMax = 16384;

// What whoever used the camera last may have left of TriggerDelay and LineInverter, with which it
// powers up.
inline constexpr float kLeftTriggerDelay_us = 40'000;

inline constexpr float kExposureMinUs = 10;
inline constexpr float kExposureMaxUs = 10'000'000;

struct Register {
  enum class Kind { kHidden, kInteger, kFloat, kEnumeration, kBoolean, kCommand, kText };
  enum class Access { kReadOnly, kReadWrite, kWriteOnly };

  std::uint32_t address = 0;
  std::string_view name = {};  // SFNC; empty for a register without a feature
  Kind kind = Kind::kHidden;
  Access access = Access::kReadWrite;
  std::string_view category = {};
  std::uint32_t length_bytes = 4;
  std::int64_t min = 0;
  std::int64_t max = 0xFFFFFFFF;
  std::string_view max_feature = {};  // name of the register that holds the maximum
  std::string_view unit = {};
  std::vector<std::pair<std::string, std::uint32_t>> entries = {};  // of an enumeration
  std::vector<std::string_view> selected = {};                      // features this one selects
  bool is_locked_while_acquiring = false;
  bool is_refused = false;  // no client can read it
};

struct DeviceDescription {
  std::string serial;
  std::string address;  // IPv4
  int width_px = 0;     // of the sensor
  int height_px = 0;
  std::vector<std::string> pixel_formats;  // PFNC names; the first is the default
  bool has_any_edge = true;                // TriggerActivation; else RisingEdge alone
  bool has_debouncer = true;               // LineDebouncerTime
  bool has_line_status = true;             // chunk LineStatusAll
  CameraVariant variant = {};
};

// Memory and its rules; what a write sets in motion is camera_model.h. Not thread-safe.
class RegisterMap {
 public:
  explicit RegisterMap(const DeviceDescription& description);

  std::uint32_t get(std::uint32_t address) const;
  void set(std::uint32_t address, std::uint32_t value);
  void set64(std::uint32_t address, std::uint64_t value);
  float get_float(std::uint32_t address) const;
  void set_float(std::uint32_t address, float value);
  // A float or an integer, as the table says.
  float get_time_us(std::uint32_t address) const;
  void set_time_us(std::uint32_t address, float time_us);

  // As a client reads: words that no register covers are an error.
  GvcpStatus read(std::uint32_t address, std::span<std::uint8_t> bytes) const;
  // Whether a client may write this word, by the table alone.
  GvcpStatus check_write(std::uint32_t address, std::uint32_t value) const;

  const std::string& xml() const { return xml_; }

 private:
  const Register* find(std::uint32_t address) const;
  bool is_writable(std::uint32_t address) const;
  bool is_readable(std::uint32_t address) const;
  void set_text(std::uint32_t address, std::string_view text);

  std::vector<Register> table_;
  std::vector<std::uint8_t> memory_;
  std::string xml_;  // padded with zeros to whole words
};

// The GenICam description of `table` and of the chunks that its ChunkSelector names.
std::string make_genicam_xml(const std::vector<Register>& table);

}  // namespace hw_sim
