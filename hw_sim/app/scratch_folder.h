// Where this program keeps what is of no use after it.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <memory>
#include <string>

#include "rig/fault.h"

namespace hw_sim {

// A folder that goes with the program however it ends, SIGKILL included: a process of its own waits
// for that. Not thread-safe.
class ScratchFolder {
 public:
  // Makes TMPDIR point to it. While the program has one thread, and before GLib is asked for
  // TMPDIR: it remembers. Errors: kNotFound (no folder can be made, with the reason).
  static rig::Result<std::unique_ptr<ScratchFolder>> make();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  // TMPDIR as it was, for other programs; empty: not set.
  const std::string& outer_tmpdir() const { return outer_tmpdir_; }

 private:
  ScratchFolder() = default;

  std::string outer_tmpdir_;
  int lifeline_ = -1;  // the keeper reads its end when we have ended
  pid_t keeper_ = -1;
};

}  // namespace hw_sim
