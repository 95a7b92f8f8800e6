// An X server that stands still, or a graphics card below it: Xlib waits for either without end. A
// wait within the driver, past the server, is none that can be ended. Internal to the projector.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <thread>

namespace rig {

// Ends the connection to a server that does not answer within a deadline. To whoever waits for it,
// it is then a server that went away. One thread of its own; that which talks to the server makes
// the calls.
class ServerWatch {
 public:
  // `connection`: the socket's descriptor.
  ServerWatch(int connection, std::chrono::milliseconds deadline);
  ~ServerWatch();
  ServerWatch(const ServerWatch&) = delete;
  ServerWatch& operator=(const ServerWatch&) = delete;

  // While it lives, its thread talks to the server, and says now and then that it was answered.
  class Talk {
   public:
    explicit Talk(ServerWatch& watch) : watch_(watch) {
      watch_.answered();
      watch_.is_talking_ = true;
    }
    ~Talk() { watch_.is_talking_ = false; }
    Talk(const Talk&) = delete;
    Talk& operator=(const Talk&) = delete;

   private:
    ServerWatch& watch_;
  };
  void answered() { ++answer_count_; }

  bool has_ended_connection() const { return has_ended_connection_; }

 private:
  void run(const std::stop_token& stop);

  const int connection_;  // a duplicate: nobody else's when the display is closed
  const std::chrono::milliseconds deadline_;
  std::atomic<bool> is_talking_{false};
  std::atomic<std::uint64_t> answer_count_{0};
  std::atomic<bool> has_ended_connection_{false};
  std::jthread thread_;
};

}  // namespace rig
