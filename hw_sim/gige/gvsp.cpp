#include "hw_sim/gige/gvsp.h"

#include <algorithm>

#include "hw_sim/gige/big_endian.h"

namespace hw_sim {
namespace {

enum class Content : std::uint32_t { kLeader = 1, kTrailer = 2, kData = 3 };

constexpr std::uint32_t kImagePayload = 0x0001;
constexpr std::uint32_t kImageWithExtendedChunks = 0x4001;

std::size_t header_bytes(bool has_64_bit_id) { return has_64_bit_id ? 20 : 8; }

void write_header(WordWriter& out, GvspStatus status, std::uint64_t block_id, bool has_64_bit_id,
                  Content content, std::uint32_t packet_id) {
  const auto content_bits = static_cast<std::uint32_t>(content) << 24;
  out.u16(static_cast<std::uint32_t>(status));
  if (!has_64_bit_id) {
    out.u16(static_cast<std::uint32_t>(block_id));
    out.u32(content_bits | (packet_id & 0xFFFFFF));
    return;
  }
  out.u16(0);
  out.u32(0x80000000U | content_bits);  // the extended-id bit; the 24 bit packet id is unused
  out.u64(block_id);
  out.u32(packet_id);
}

void write_leader(WordWriter& out, const GvspBlock& block) {
  out.u32(block.has_chunks ? kImageWithExtendedChunks : kImagePayload);
  out.u64(block.timestamp_ns);
  out.u32(block.pixel_format);
  out.u32(block.width_px);
  out.u32(block.height_px);
  out.u32(block.offset_x_px);
  out.u32(block.offset_y_px);
  out.u16(block.line_padding_bytes);
  out.u16(0);  // none behind the last row
}

void write_trailer(WordWriter& out, const GvspBlock& block) {
  out.u32(block.has_chunks ? kImageWithExtendedChunks : kImagePayload);
  out.u32(block.height_px);
  if (block.has_chunks) out.u32(block.chunk_layout_id);
}

}  // namespace

std::size_t GvspBlock::data_bytes_per_packet() const {
  return packet_size_bytes - kUdpHeaderBytes - header_bytes(has_64_bit_id);
}

std::uint32_t GvspBlock::packet_count() const {
  const std::size_t step = data_bytes_per_packet();
  return static_cast<std::uint32_t>((payload.size() + step - 1) / step) + 2;
}

GvspPacket make_gvsp_packet(const GvspBlock& block, std::uint32_t packet_id, GvspStatus status) {
  const bool is_leader = packet_id == 0;
  const bool is_trailer = packet_id + 1 == block.packet_count();
  const Content content = is_leader    ? Content::kLeader
                          : is_trailer ? Content::kTrailer
                                       : Content::kData;
  GvspPacket packet;
  WordWriter out(packet.header.data());
  write_header(out, status, block.id, block.has_64_bit_id, content, packet_id);
  if (is_leader) {
    write_leader(out, block);
  } else if (is_trailer) {
    write_trailer(out, block);
  } else {
    const std::size_t step = block.data_bytes_per_packet();
    const std::size_t start = (packet_id - 1) * step;
    packet.data =
        std::span(block.payload).subspan(start, std::min(step, block.payload.size() - start));
  }
  packet.header_bytes = out.size();
  return packet;
}

GvspPacket make_unavailable_packet(std::uint64_t block_id, bool has_64_bit_id,
                                   std::uint32_t packet_id) {
  GvspPacket packet;
  WordWriter out(packet.header.data());
  write_header(out, GvspStatus::kPacketUnavailable, block_id, has_64_bit_id, Content::kData,
               packet_id);
  packet.header_bytes = out.size();
  return packet;
}

}  // namespace hw_sim
