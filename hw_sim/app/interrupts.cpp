#include "hw_sim/app/interrupts.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdlib>

namespace hw_sim {

Interrupts::Interrupts() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  if (std::signal(SIGHUP, SIG_DFL) != SIG_IGN)  // ignored: under nohup, which means it
    sigaddset(&signals, SIGHUP);
  else
    std::signal(SIGHUP, SIG_IGN);
  sigprocmask(SIG_BLOCK, &signals, nullptr);
  descriptor_ = signalfd(-1, &signals, SFD_CLOEXEC | SFD_NONBLOCK);
}

Interrupts::~Interrupts() { close(descriptor_); }

std::optional<Interrupt> Interrupts::take() {
  signalfd_siginfo info{};
  if (read(descriptor_, &info, sizeof info) != sizeof info) return std::nullopt;
  return Interrupt{static_cast<int>(info.ssi_signo), info.ssi_code == SI_KERNEL};
}

ExitOnInterrupt::ExitOnInterrupt(Interrupts& interrupts)
    : wake_(eventfd(0, EFD_CLOEXEC)), thread_([this, &interrupts] {
        std::array<pollfd, 2> sources{{{wake_, POLLIN, 0}, {interrupts.descriptor(), POLLIN, 0}}};
        while (poll(sources.data(), sources.size(), -1) < 0) continue;
        if (sources[0].revents != 0) return;
        if (const std::optional<Interrupt> interrupt = interrupts.take(); interrupt)
          std::_Exit(128 + interrupt->signal);
      }) {}

ExitOnInterrupt::~ExitOnInterrupt() {
  eventfd_write(wake_, 1);
  thread_.join();
  close(wake_);
}

}  // namespace hw_sim
