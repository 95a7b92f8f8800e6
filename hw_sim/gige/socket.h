// A UDP socket that closes itself.
#pragma once

#include <netinet/in.h>

#include <cstdint>
#include <string>

#include "rig/fault.h"

namespace hw_sim {

class Socket {
 public:
  Socket() = default;
  Socket(Socket&& other) noexcept;
  Socket& operator=(Socket&& other) noexcept;
  ~Socket();

  // Bound to an IPv4 address and port (0: any). Errors: kNotFound, naming address, port and cause.
  static rig::Result<Socket> bind_udp(const std::string& address, std::uint16_t port,
                                      bool is_shared);

  int fd() const { return fd_; }
  bool is_open() const { return fd_ >= 0; }
  std::uint16_t port() const;
  // A packet larger than the path's MTU is not sent, as from a camera.
  void forbid_fragments();

 private:
  explicit Socket(int fd) : fd_(fd) {}
  int fd_ = -1;
};

// A camera's network port does not wait for the host's other programs: the calling thread goes
// before every ordinary one where that is permitted (root, CAP_SYS_NICE), else stays as it is.
void run_like_hardware();

}  // namespace hw_sim
