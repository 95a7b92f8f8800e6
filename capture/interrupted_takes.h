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

  // Whether capturing can go on: not in a session of another program, which has no such journal.
  bool is_resumable() const { return slot_count > 0; }
  // One sentence: what is there.
  std::string text() const;
  // The command that finishes it or, where nothing can, makes maps of what there is; for a shell.
  std::string remedy(const std::filesystem::path& rig_file) const;
};

// Whether the session at `session` is one: its manifest says that it is being captured, and nobody
// does. Reads no frame: `ssrig verify` and resuming do.
std::optional<InterruptedTake> find_interruption(const std::filesystem::path& session);

// All in `directory` that can be finished, by name. What cannot be read is passed over.
std::vector<InterruptedTake> list_interrupted_takes(const std::filesystem::path& directory);

}  // namespace capture
