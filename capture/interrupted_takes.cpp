#include "capture/interrupted_takes.h"

#include <algorithm>
#include <set>
#include <system_error>

#include "capture/stored_take.h"
#include "estimation/session/manifest.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

// Files that are as long as the journal says; those that it does not know as long as the others.
int count_good_files(const fs::path& session, const Journal& journal) {
  std::set<std::uintmax_t> sizes;
  for (const auto& [file, frame] : journal.frames)
    if (frame.byte_count) sizes.insert(*frame.byte_count);
  int count = 0;
  std::error_code error;
  for (fs::directory_iterator it(session / "frames", error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() != ".tiff") continue;
    std::error_code unknown;
    const std::uintmax_t size = fs::file_size(it->path(), unknown);
    const auto told = journal.frames.find((fs::path("frames") / it->path().filename()).string());
    const bool is_told = told != journal.frames.end() && told->second.byte_count;
    const bool is_good =
        is_told ? size == *told->second.byte_count : sizes.empty() || sizes.contains(size);
    if (!unknown && is_good) ++count;
  }
  return count;
}

}  // namespace

std::string InterruptedTake::text() const {
  const std::string count = slot_count > 0 ? std::to_string(good_count) + " of " +
                                                 std::to_string(slot_count) + " slots are"
                                           : std::to_string(good_count) + " frames are";
  return session.string() + " was interrupted: " + count + " good on the disk";
}

std::string InterruptedTake::remedy(const fs::path& rig_file) const {
  return "ssrig capture --rig " + rig_file.string() + " --resume " + session.string();
}

std::optional<InterruptedTake> find_interruption(const fs::path& session) {
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return std::nullopt;
  const bool is_open = manifest->state == estimation::SessionState::kCapturing ||
                       manifest->state == estimation::SessionState::kInterrupted;
  if (!is_open || is_under_way(session)) return std::nullopt;
  const Journal journal = read_journal(session);
  InterruptedTake take;
  take.session = session;
  take.good_count = count_good_files(session, journal);
  if (journal.beginning)
    take.slot_count =
        static_cast<int>(manifest->patterns.size() * journal.beginning->exposures.size());
  return take;
}

std::vector<InterruptedTake> list_interrupted_takes(const fs::path& directory) {
  std::vector<InterruptedTake> takes;
  std::error_code error;
  for (fs::directory_iterator it(directory, error), end; !error && it != end; it.increment(error)) {
    std::error_code unknown;
    if (!it->is_directory(unknown)) continue;
    if (auto take = find_interruption(it->path())) takes.push_back(std::move(*take));
  }
  std::sort(takes.begin(), takes.end(), [](const InterruptedTake& a, const InterruptedTake& b) {
    return a.session < b.session;
  });
  return takes;
}

}  // namespace capture
