// Ctrl-C, SIGTERM and the end of the terminal as a stop token.
#pragma once

#include <signal.h>

#include <stop_token>
#include <thread>

namespace capture {

// Made first in main(), before any other thread: the signals are blocked for all threads and taken
// by one of its own. At the second signal the program ends at once.
class Interrupts {
 public:
  Interrupts();
  ~Interrupts();
  Interrupts(const Interrupts&) = delete;
  Interrupts& operator=(const Interrupts&) = delete;

  std::stop_token stop() const { return stop_.get_token(); }

 private:
  void run(const std::stop_token& is_over);

  sigset_t signals_;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace capture
