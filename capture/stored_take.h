// What of a take lies on the disk: its manifest, what its journal says, and which slots are good.
#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/plan.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// How a take was begun; the journal's first line, see begin_line() in capture/journal.h.
struct TakeBeginning {
  std::vector<std::chrono::microseconds> exposures;  // brackets
  std::vector<int> order;                            // of projection
  std::map<std::string, std::string> settings;       // that the manifest does not hold
};

struct JournalledFrame {
  estimation::FrameRecord record;
  std::optional<std::uintmax_t> byte_count;
};

struct Journal {
  std::optional<TakeBeginning> beginning;
  std::map<std::string, JournalledFrame> frames;  // by file
};

// Lines that are none of ours, torn or beyond what their members hold are passed over.
Journal parse_journal(std::string_view text);

// A missing journal is an empty one.
Journal read_journal(const std::filesystem::path& session);

// Somebody's SessionWriter has the session open.
bool is_under_way(const std::filesystem::path& session);

struct StoredTake {
  estimation::Manifest manifest;  // as it stands on the disk
  Journal journal;
  // [pattern * brackets + bracket] of those that are good: read whole, and as the checksum of the
  // journal or the manifest says or, where they have none, such as can be decoded.
  std::vector<std::optional<estimation::FrameRecord>> slots;
  std::vector<std::string> damaged_files;  // under a slot's name, but not good

  int good_count() const;
};

// Gives a file of a session another name, its own with `suffix` appended, and a number where that
// is taken; returns it. Errors: kUnwritable.
estimation::Result<std::filesystem::path> set_aside(const std::filesystem::path& file,
                                                    const std::string& suffix);

// Replaces the session's manifest: the old one or the new one is there, whole. Errors: kUnwritable.
estimation::Result<void> store_manifest(const std::filesystem::path& session,
                                        const estimation::Manifest& manifest);

// Reads and checks every frame that is there. `planned` names the slots' files. Error: no manifest
// that can be read.
estimation::Result<StoredTake> read_take(const std::filesystem::path& session,
                                         const std::vector<estimation::FrameRecord>& planned);

}  // namespace capture
