// Takes that a crash or a power cut has left unfinished, for an operator to see at the next start.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace capture {

struct InterruptedTake {
  std::filesystem::path session;
  int good_count = 0;  // slots whose file is there, as long as the journal says
  int slot_count = 0;  // 0: unknown, its journal does not say how it was begun

  // One sentence: what is there.
  std::string text() const;
  // The command that finishes it.
  std::string remedy(const std::filesystem::path& rig_file) const;
};

// Whether the session at `session` is one: its manifest says that it is being captured, and nobody
// does. Reads no frame: `ssrig verify` and resuming do.
std::optional<InterruptedTake> find_interruption(const std::filesystem::path& session);

// All in `directory`, by name. What cannot be read is passed over.
std::vector<InterruptedTake> list_interrupted_takes(const std::filesystem::path& directory);

}  // namespace capture
