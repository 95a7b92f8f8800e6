#include "hw_sim/gige/stream_sender.h"

#include <sys/socket.h>
#include <sys/uio.h>

#include <algorithm>

#include "hw_sim/gige/big_endian.h"

namespace hw_sim {
namespace {

// Ethernet header, checksum, preamble and gap: what a packet costs on the wire beside itself.
constexpr double kEthernetOverheadBytes = 38;
// Shorter waits than this cost more than the burst they avoid.
constexpr std::chrono::microseconds kPacingGrain{150};
// A sender that was held up makes up this much and no more: a link has no faster gear.
constexpr std::chrono::microseconds kCatchUpMax{1000};

}  // namespace

StreamSender::StreamSender(Socket socket, double link_rate_bit_per_s, GigeFaults& faults)
    : socket_(std::move(socket)),
      link_rate_bit_per_s_(link_rate_bit_per_s),
      faults_(faults),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

void StreamSender::set_destination(std::uint32_t address, std::uint16_t port) {
  const std::lock_guard lock(mutex_);
  destination_ = {};
  destination_.sin_family = AF_INET;
  destination_.sin_addr.s_addr = htonl(address);
  destination_.sin_port = htons(port);
}

std::shared_ptr<GvspBlock> StreamSender::take_block() {
  const std::lock_guard lock(mutex_);
  if (spare_.empty()) return std::make_shared<GvspBlock>();
  std::shared_ptr<GvspBlock> block = std::move(spare_.back());
  spare_.pop_back();
  return block;
}

void StreamSender::send(std::shared_ptr<GvspBlock> block, rig::HostTime earliest) {
  {
    const std::lock_guard lock(mutex_);
    queue_.push_back({std::move(block), earliest});
  }
  queued_.notify_one();
}

void StreamSender::resend(const ResendRequest& request, bool has_64_bit_id) {
  if (faults_.is_resend_ignored) return;
  std::shared_ptr<GvspBlock> block;
  std::uint64_t acquisition = 0;
  {
    const std::lock_guard lock(mutex_);
    block = find_kept(request.block_id);
    acquisition = acquisition_;
  }
  if (!block) {
    send_packet(make_unavailable_packet(request.block_id, has_64_bit_id, request.first_packet),
                acquisition);
    return;
  }
  const std::uint32_t last = std::min(request.last_packet, block->packet_count() - 1);
  for (std::uint32_t packet = request.first_packet; packet <= last; ++packet) {
    ++resent_packet_count_;
    if (!is_lost(*block))
      send_packet(make_gvsp_packet(*block, packet, GvspStatus::kPacketResend), acquisition);
  }
}

void StreamSender::fire_test_packet(std::size_t packet_size_bytes) {
  GvspPacket packet;
  const std::vector<std::uint8_t> zeros(packet_size_bytes - kUdpHeaderBytes);
  packet.data = zeros;
  std::uint64_t acquisition = 0;
  {
    const std::lock_guard lock(mutex_);
    acquisition = acquisition_;
  }
  send_packet(packet, acquisition);
}

void StreamSender::end_acquisition() {
  {
    const std::lock_guard lock(mutex_);
    ++acquisition_;
    queue_.clear();
    kept_.clear();
  }
  queued_.notify_one();
}

StreamCounters StreamSender::counters() const {
  return {.sent_frame_count = sent_frame_count_,
          .sent_packet_count = sent_packet_count_,
          .resent_packet_count = resent_packet_count_,
          .lost_packet_count = lost_packet_count_};
}

void StreamSender::run(const std::stop_token& stop) {
  run_like_hardware();
  while (const std::optional<Outgoing> next = next_block(stop)) {
    const ShotFaults& planned = next->block->faults;
    if (take_one(faults_.lost_frames) || planned.is_lost) continue;
    const bool is_truncated = take_one(faults_.truncated_frames) || planned.is_truncated;
    if (!is_truncated) keep(*next);
    const std::uint32_t packet_count = next->block->packet_count();
    send_packets(*next, is_truncated ? packet_count / 2 : packet_count, stop);
    ++sent_frame_count_;
  }
}

// The next block once it may leave; nullopt on stop.
std::optional<StreamSender::Outgoing> StreamSender::next_block(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (queued_.wait(lock, stop, [this] { return !queue_.empty(); })) {
    const rig::HostTime earliest = queue_.front().earliest;
    // Woken early when end_acquisition() emptied the queue.
    if (queued_.wait_until(lock, stop, earliest, [this] { return queue_.empty(); })) continue;
    if (stop.stop_requested()) return std::nullopt;
    Outgoing next{std::move(queue_.front().block), acquisition_};
    queue_.pop_front();
    return next;
  }
  return std::nullopt;
}

void StreamSender::send_packets(const Outgoing& outgoing, std::uint32_t sent_count,
                                const std::stop_token& stop) {
  const GvspBlock& block = *outgoing.block;
  link_free_ = std::max(link_free_, rig::HostClock::now());
  for (std::uint32_t packet = 0; packet < sent_count && !stop.stop_requested(); ++packet) {
    const bool is_leader_lost =
        packet == 0 && (take_one(faults_.lost_leaders) || block.faults.is_leader_lost);
    const bool is_trailer_lost = packet + 1 == block.packet_count() &&
                                 (take_one(faults_.lost_trailers) || block.faults.is_trailer_lost);
    if (is_leader_lost || is_trailer_lost || is_lost(block)) {
      ++lost_packet_count_;
    } else {
      const GvspPacket made = make_gvsp_packet(block, packet, GvspStatus::kSuccess);
      send_packet(made, outgoing.acquisition);
      if (faults_.are_packets_duplicated || block.faults.is_duplicated)
        send_packet(made, outgoing.acquisition);
    }
    pace(block.packet_size_bytes);
  }
}

// Locked while it sends, so that no packet of an acquisition leaves after its end.
void StreamSender::send_packet(const GvspPacket& packet, std::uint64_t acquisition) {
  if (faults_.is_mute) return;
  const std::lock_guard lock(mutex_);
  if (acquisition != acquisition_ || destination_.sin_port == 0) return;
  std::array<iovec, 2> pieces{};
  pieces[0] = {const_cast<std::uint8_t*>(packet.header.data()),  // NOLINT: sendmsg only reads
               packet.header_bytes};
  pieces[1] = {const_cast<std::uint8_t*>(packet.data.data()), packet.data.size()};  // NOLINT
  msghdr message{};
  message.msg_name = &destination_;
  message.msg_namelen = sizeof destination_;
  message.msg_iov = pieces.data();
  message.msg_iovlen = pieces.size();
  if (sendmsg(socket_.fd(), &message, 0) >= 0) ++sent_packet_count_;
}

void StreamSender::pace(std::size_t packet_size_bytes) {
  if (link_rate_bit_per_s_ <= 0) return;
  const double wire_bits = (static_cast<double>(packet_size_bytes) + kEthernetOverheadBytes) * 8;
  link_free_ +=
      std::chrono::nanoseconds(static_cast<std::int64_t>(wire_bits / link_rate_bit_per_s_ * 1e9));
  const rig::HostTime now = rig::HostClock::now();
  link_free_ = std::max(link_free_, now - kCatchUpMax);
  if (link_free_ - now > kPacingGrain) std::this_thread::sleep_until(link_free_);
}

bool StreamSender::is_lost(const GvspBlock& block) {
  const double loss_frac = std::max(faults_.packet_loss_frac.load(), block.faults.loss_frac);
  if (loss_frac <= 0) return false;
  const std::lock_guard lock(mutex_);
  return std::uniform_real_distribution<double>(0, 1)(loss_draw_) < loss_frac;
}

std::shared_ptr<GvspBlock> StreamSender::find_kept(std::uint64_t block_id) const {
  for (const auto& block : kept_)
    if (block->id == block_id) return block;
  return nullptr;
}

void StreamSender::keep(const Outgoing& outgoing) {
  const std::lock_guard lock(mutex_);
  if (outgoing.acquisition != acquisition_) return;
  kept_.push_back(outgoing.block);
  const std::size_t limit =
      kKeptBytesMax / std::max<std::size_t>(outgoing.block->payload.size(), 1);
  if (kept_.size() <= std::clamp(limit, kKeptBlocksMin, kKeptBlocksMax)) return;
  // A resend may still be reading the oldest; then it is let go instead of used again.
  if (kept_.front().use_count() == 1) spare_.push_back(std::move(kept_.front()));
  kept_.pop_front();
}

}  // namespace hw_sim
