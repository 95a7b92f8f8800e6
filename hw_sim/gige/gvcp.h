// GVCP, the control half of GigE Vision: requests parsed, acknowledges built.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace hw_sim {

inline constexpr std::uint16_t kGvcpPort = 3956;

enum class GvcpCommand : std::uint16_t {
  kDiscovery = 0x0002,
  kPacketResend = 0x0040,
  kReadRegister = 0x0080,
  kWriteRegister = 0x0082,
  kReadMemory = 0x0084,
  kWriteMemory = 0x0086
};

// Source: GigE Vision 2.0, status codes.
enum class GvcpStatus : std::uint16_t {
  kSuccess = 0x0000,
  kNotImplemented = 0x8001,
  kInvalidParameter = 0x8002,
  kInvalidAddress = 0x8003,
  kWriteProtected = 0x8004,
  kBadAlignment = 0x8005,
  kAccessDenied = 0x8006
};

struct GvcpRequest {
  bool is_acknowledge_wanted = false;
  bool has_64_bit_block_id = false;  // of a packet resend request
  std::uint16_t command = 0;
  std::uint16_t id = 0;
  std::span<const std::uint8_t> payload;  // borrows from the datagram
};

// nullopt for anything that is not a whole request.
std::optional<GvcpRequest> parse_gvcp(std::span<const std::uint8_t> datagram);

std::vector<std::uint8_t> make_acknowledge(const GvcpRequest& request, GvcpStatus status,
                                           std::span<const std::uint8_t> payload);

struct ResendRequest {
  std::uint64_t block_id = 0;
  std::uint32_t first_packet = 0;
  std::uint32_t last_packet = 0;
};

std::optional<ResendRequest> parse_resend(const GvcpRequest& request);

}  // namespace hw_sim
