#include "capture/app/interrupts.h"

#include <pthread.h>
#include <unistd.h>

#include <csignal>
#include <ctime>

#include "capture/exit_code.h"

namespace capture {

Interrupts::Interrupts() {
  sigemptyset(&signals_);
  sigaddset(&signals_, SIGINT);
  sigaddset(&signals_, SIGTERM);
  if (std::signal(SIGHUP, SIG_DFL) != SIG_IGN)  // ignored: under nohup, which means it
    sigaddset(&signals_, SIGHUP);
  else
    std::signal(SIGHUP, SIG_IGN);
  pthread_sigmask(SIG_BLOCK, &signals_, nullptr);
  thread_ = std::jthread([this](const std::stop_token& is_over) { run(is_over); });
}

Interrupts::~Interrupts() {
  thread_.request_stop();
  // Wakes the thread, for the signal is blocked there and waited for.
  // NOLINTNEXTLINE(bugprone-bad-signal-to-kill-thread): a blocked signal terminates nothing
  pthread_kill(thread_.native_handle(), SIGTERM);
}

void Interrupts::run(const std::stop_token& is_over) {
  while (true) {
    int signal = 0;
    if (sigwait(&signals_, &signal) != 0 || is_over.stop_requested()) return;
    if (!stop_.request_stop()) ::_exit(static_cast<int>(ExitCode::kAborted));
  }
}

}  // namespace capture
