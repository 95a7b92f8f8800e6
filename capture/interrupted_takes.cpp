#include "capture/interrupted_takes.h"

#include <algorithm>
#include <set>
#include <string_view>
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

// As a shell takes it for one word.
std::string as_word(const fs::path& path) {
  const std::string text = path.string();
  constexpr std::string_view kPlain =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-./+:,=@%";
  if (!text.empty() && text.find_first_not_of(kPlain) == std::string::npos) return text;
  std::string word = "'";
  for (const char c : text) {
    if (c == '\'')
      word.append("'\\''");
    else
      word.push_back(c);
  }
  return word.append("'");
}

}  // namespace

std::string InterruptedTake::text() const {
  if (!is_resumable())
    return session.string() +
           " is not complete and cannot be resumed: it has no journal that says how it was begun, "
           "as sessions of other programs have none";
  return session.string() + " was interrupted: " + std::to_string(good_count) + " of " +
         std::to_string(slot_count) + " slots are good on the disk";
}

std::string InterruptedTake::remedy(const fs::path& rig_file) const {
  if (!is_resumable()) return "ssrig estimate " + as_word(session);
  return "ssrig capture --rig " + as_word(rig_file) + " --resume " + as_word(session);
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
    auto take = find_interruption(it->path());
    if (take && take->is_resumable()) takes.push_back(std::move(*take));
  }
  std::sort(takes.begin(), takes.end(), [](const InterruptedTake& a, const InterruptedTake& b) {
    return a.session < b.session;
  });
  return takes;
}

}  // namespace capture
