// GVSP, the stream half of GigE Vision: a block (one frame) as leader, data packets and trailer.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "hw_sim/faults/fault_schedule.h"

namespace hw_sim {

inline constexpr std::size_t kUdpHeaderBytes = 28;  // IPv4 and UDP

// One frame, ready to be sent: the image and, when chunks are on, the chunks behind it.
struct GvspBlock {
  std::uint64_t id = 0;
  bool has_64_bit_id = false;
  bool has_chunks = false;
  std::uint32_t chunk_layout_id = 0;
  std::uint64_t timestamp_ns = 0;  // camera clock, start of exposure
  std::uint32_t pixel_format = 0;  // PFNC code
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
  std::uint32_t offset_x_px = 0;
  std::uint32_t offset_y_px = 0;
  std::uint16_t line_padding_bytes = 0;  // as the leader says
  std::size_t packet_size_bytes = 1500;  // IP and UDP headers included, as in GevSCPSPacketSize
  std::vector<std::uint8_t> payload;
  ShotFaults faults{};  // what happens to it on its way

  std::size_t data_bytes_per_packet() const;
  // Leader (packet 0), data packets, trailer (the last).
  std::uint32_t packet_count() const;
};

// GVSP status of a packet.
enum class GvspStatus : std::uint16_t {
  kSuccess = 0x0000,
  kPacketResend = 0x0100,
  kPacketUnavailable = 0x800C
};

// One packet as two pieces, so that image data are never copied: `header` holds the GVSP header and
// a leader's or trailer's whole content, `data` borrows from the block's payload.
struct GvspPacket {
  std::array<std::uint8_t, 64> header{};
  std::size_t header_bytes = 0;
  std::span<const std::uint8_t> data;
};

GvspPacket make_gvsp_packet(const GvspBlock& block, std::uint32_t packet_id, GvspStatus status);

// The answer to a resend request for a block that is no longer kept.
GvspPacket make_unavailable_packet(std::uint64_t block_id, bool has_64_bit_id,
                                   std::uint32_t packet_id);

}  // namespace hw_sim
