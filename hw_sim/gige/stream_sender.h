// The sending half of the stream channel: blocks out at the link's rate, the last ones kept for
// resend requests.
#pragma once

#include <netinet/in.h>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <stop_token>
#include <thread>
#include <vector>

#include "hw_sim/gige/faults.h"
#include "hw_sim/gige/gvcp.h"
#include "hw_sim/gige/gvsp.h"
#include "hw_sim/gige/socket.h"
#include "rig/clock.h"

namespace hw_sim {

struct StreamCounters {
  std::uint64_t sent_frame_count = 0;
  std::uint64_t sent_packet_count = 0;
  std::uint64_t resent_packet_count = 0;
  std::uint64_t lost_packet_count = 0;  // by a fault
};

// Thread-safe. Starts one thread, the sender.
class StreamSender {
 public:
  // `link_rate_bit_per_s` 0: as fast as it goes.
  StreamSender(Socket socket, double link_rate_bit_per_s, GigeFaults& faults);

  // Where packets go; port 0: nowhere.
  void set_destination(std::uint32_t address, std::uint16_t port);
  // A block to fill: one that was sent long ago, or a new one.
  std::shared_ptr<GvspBlock> take_block();
  // The block leaves at `earliest`, or when those before it have left.
  void send(std::shared_ptr<GvspBlock> block, rig::HostTime earliest);
  void resend(const ResendRequest& request, bool has_64_bit_id);
  void fire_test_packet(std::size_t packet_size_bytes);
  // Nothing of what was given so far is sent or kept any longer, on no account.
  void end_acquisition();
  StreamCounters counters() const;
  std::uint16_t source_port() const { return socket_.port(); }

 private:
  struct Queued {
    std::shared_ptr<GvspBlock> block;  // shared: a resend may read it while the ring lets it go
    rig::HostTime earliest;
  };
  struct Outgoing {
    std::shared_ptr<GvspBlock> block;
    std::uint64_t acquisition = 0;
  };
  // Blocks that resend requests can still ask for: as many as a camera's memory holds.
  static constexpr std::size_t kKeptBytesMax = std::size_t{128} << 20;
  static constexpr std::size_t kKeptBlocksMin = 4;
  static constexpr std::size_t kKeptBlocksMax = 64;

  void run(const std::stop_token& stop);
  std::optional<Outgoing> next_block(const std::stop_token& stop);
  void send_packets(const Outgoing& outgoing, std::uint32_t sent_count,
                    const std::stop_token& stop);
  void send_packet(const GvspPacket& packet, std::uint64_t acquisition);
  void pace(std::size_t packet_size_bytes);
  bool is_lost(const GvspBlock& block);
  std::shared_ptr<GvspBlock> find_kept(std::uint64_t block_id) const;  // mutex_ is held
  void keep(const Outgoing& outgoing);

  const Socket socket_;
  const double link_rate_bit_per_s_;
  GigeFaults& faults_;
  rig::HostTime link_free_;  // used by the sender thread only

  mutable std::mutex mutex_;
  std::condition_variable_any queued_;
  std::uint64_t acquisition_ = 0;                  // guarded by mutex_; ended ones so far
  sockaddr_in destination_{};                      // guarded by mutex_
  std::deque<Queued> queue_;                       // guarded by mutex_
  std::deque<std::shared_ptr<GvspBlock>> kept_;    // guarded by mutex_
  std::vector<std::shared_ptr<GvspBlock>> spare_;  // guarded by mutex_
  std::mt19937_64 loss_draw_{1};                   // guarded by mutex_
  std::atomic<std::uint64_t> sent_frame_count_{0};
  std::atomic<std::uint64_t> sent_packet_count_{0};
  std::atomic<std::uint64_t> resent_packet_count_{0};
  std::atomic<std::uint64_t> lost_packet_count_{0};
  std::jthread thread_;
};

}  // namespace hw_sim
