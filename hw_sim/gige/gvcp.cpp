#include "hw_sim/gige/gvcp.h"

#include <algorithm>

#include "hw_sim/gige/big_endian.h"

namespace hw_sim {
namespace {

constexpr std::uint8_t kRequestKey = 0x42;
constexpr std::uint8_t kAcknowledgeFlag = 0x01;
constexpr std::uint8_t kExtendedIdFlag = 0x10;
constexpr std::size_t kHeaderBytes = 8;

}  // namespace

std::optional<GvcpRequest> parse_gvcp(std::span<const std::uint8_t> datagram) {
  if (datagram.size() < kHeaderBytes || datagram[0] != kRequestKey) return std::nullopt;
  const std::size_t payload_bytes = get16(&datagram[4]);
  if (datagram.size() < kHeaderBytes + payload_bytes) return std::nullopt;
  return GvcpRequest{.is_acknowledge_wanted = (datagram[1] & kAcknowledgeFlag) != 0,
                     .has_64_bit_block_id = (datagram[1] & kExtendedIdFlag) != 0,
                     .command = get16(&datagram[2]),
                     .id = get16(&datagram[6]),
                     .payload = datagram.subspan(kHeaderBytes, payload_bytes)};
}

std::vector<std::uint8_t> make_acknowledge(const GvcpRequest& request, GvcpStatus status,
                                           std::span<const std::uint8_t> payload) {
  std::vector<std::uint8_t> bytes(kHeaderBytes + payload.size());
  WordWriter out(bytes.data());
  out.u16(static_cast<std::uint32_t>(status));
  out.u16(request.command + 1U);
  out.u16(static_cast<std::uint32_t>(payload.size()));
  out.u16(request.id);
  std::copy(payload.begin(), payload.end(), bytes.begin() + kHeaderBytes);
  return bytes;
}

std::optional<ResendRequest> parse_resend(const GvcpRequest& request) {
  const std::span<const std::uint8_t> body = request.payload;
  if (body.size() < (request.has_64_bit_block_id ? 20U : 12U)) return std::nullopt;
  const std::uint32_t packet_mask = request.has_64_bit_block_id ? 0xFFFFFFFFU : 0xFFFFFFU;
  return ResendRequest{.block_id = request.has_64_bit_block_id ? get64(&body[12]) : get16(&body[2]),
                       .first_packet = get32(&body[4]) & packet_mask,
                       .last_packet = get32(&body[8]) & packet_mask};
}

}  // namespace hw_sim
