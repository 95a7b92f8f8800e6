#include "hw_sim/gige/socket.h"

#include <arpa/inet.h>
#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

namespace hw_sim {

Socket::Socket(Socket&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

Socket& Socket::operator=(Socket&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

Socket::~Socket() {
  if (fd_ >= 0) close(fd_);
}

rig::Result<Socket> Socket::bind_udp(const std::string& address, std::uint16_t port,
                                     bool is_shared) {
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_port = htons(port);
  if (inet_pton(AF_INET, address.c_str(), &name.sin_addr) != 1)
    return rig::failure(rig::Fault::kConfiguration, "'" + address + "' is not an IPv4 address");
  Socket made(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  const int on = 1;
  if (is_shared) setsockopt(made.fd(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (!made.is_open() || bind(made.fd(), reinterpret_cast<sockaddr*>(&name), sizeof name) != 0)
    return rig::failure(rig::Fault::kNotFound,
                        "cannot bind UDP " + address + ":" + std::to_string(port) + ": " +
                            std::strerror(errno) +
                            "; is another simulated camera running at this address?");
  return made;
}

void Socket::forbid_fragments() {
  const int mode = IP_PMTUDISC_DO;
  setsockopt(fd_, IPPROTO_IP, IP_MTU_DISCOVER, &mode, sizeof mode);
}

std::uint16_t Socket::port() const {
  sockaddr_in name{};
  socklen_t length = sizeof name;
  getsockname(fd_, reinterpret_cast<sockaddr*>(&name), &length);
  return ntohs(name.sin_port);
}

void run_like_hardware() {
  const sched_param parameters{.sched_priority = 5};  // below the client's receiver, which has 10
  pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);
}

}  // namespace hw_sim
