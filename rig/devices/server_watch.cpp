#include "rig/devices/server_watch.h"

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <condition_variable>
#include <mutex>

namespace rig {
namespace {

// The deadline is counted in looks and not by the clock, on which a program that was itself
// stopped for a while finds it long past.
constexpr int kLookLimit = 20;

}  // namespace

ServerWatch::ServerWatch(int connection, std::chrono::milliseconds deadline)
    : connection_(fcntl(connection, F_DUPFD_CLOEXEC, 0)),
      deadline_(deadline),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

ServerWatch::~ServerWatch() {
  thread_ = {};
  close(connection_);
}

void ServerWatch::run(const std::stop_token& stop) {
  std::mutex mutex;  // nobody else's: the wait ends by the stop or the time
  std::condition_variable_any never;
  std::unique_lock lock(mutex);
  std::uint64_t last_count = answer_count_;
  for (int look = 0; look < kLookLimit; ++look) {
    never.wait_for(lock, stop, deadline_ / kLookLimit, [] { return false; });
    if (stop.stop_requested()) return;
    const std::uint64_t count = answer_count_;
    if (is_talking_ && count == last_count) continue;
    last_count = count;
    look = -1;  // the next one is the first again
  }
  has_ended_connection_ = true;
  shutdown(connection_, SHUT_RDWR);
}

}  // namespace rig
