// SIGINT and SIGTERM as something to wait for, instead of something that happens in between.
#pragma once

#include <csignal>
#include <optional>
#include <thread>

namespace hw_sim {

struct Interrupt {
  int signal = 0;
  bool is_from_terminal = false;  // Ctrl-C: our child got it, too
};

// Make one before the first thread is started; later threads inherit the blocked signals.
class Interrupts {
 public:
  Interrupts();
  ~Interrupts();
  Interrupts(const Interrupts&) = delete;
  Interrupts& operator=(const Interrupts&) = delete;

  int descriptor() const { return descriptor_; }  // readable when there is one
  std::optional<Interrupt> take();

 private:
  int descriptor_;
};

// While one lives, an interrupt ends the program at once: for long computations with nothing to
// clean up.
class ExitOnInterrupt {
 public:
  explicit ExitOnInterrupt(Interrupts& interrupts);
  ~ExitOnInterrupt();
  ExitOnInterrupt(const ExitOnInterrupt&) = delete;
  ExitOnInterrupt& operator=(const ExitOnInterrupt&) = delete;

 private:
  int wake_;
  std::jthread thread_;
};

}  // namespace hw_sim
