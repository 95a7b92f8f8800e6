// A program that we start, watch and end.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "rig/clock.h"
#include "rig/fault.h"

namespace hw_sim {

struct ChildSettings {
  std::vector<std::string> argv;                     // argv[0] is looked up in PATH
  std::map<std::string, std::string> environment{};  // set beside ours; an empty value removes
  std::filesystem::path output{};                    // of stdout and stderr; empty: ours
  bool is_own_session = false;                       // away from our terminal's Ctrl-C
  int inherited_descriptor = -1;                     // kept open under its number
};

// Ends with its owner, even if we are killed: the kernel then sends it SIGTERM, when the thread
// that started it ends. Not thread-safe.
class ChildProcess {
 public:
  // Errors: kNotFound, with the reason that exec gave.
  static rig::Result<ChildProcess> start(const ChildSettings& settings);
  ChildProcess(ChildProcess&& other) noexcept;
  ChildProcess& operator=(ChildProcess&& other) noexcept;
  ~ChildProcess();  // SIGTERM, and SIGKILL after 5 s

  // Its exit code, 128 + signal as in a shell; nullopt at `deadline`. May be called again.
  std::optional<int> wait(rig::HostTime deadline);
  void send(int signal);
  // Readable when the program has ended.
  int descriptor() const { return descriptor_; }
  pid_t pid() const { return pid_; }

 private:
  ChildProcess() = default;
  void end() noexcept;

  pid_t pid_ = -1;  // -1: moved from
  int descriptor_ = -1;
  std::optional<int> exit_code_;
};

}  // namespace hw_sim
