#include "hw_sim/app/session_watch.h"

#include <algorithm>
#include <iterator>
#include <string_view>
#include <system_error>

namespace hw_sim {
namespace {

std::vector<std::filesystem::path> out_folders(const std::vector<std::string>& command) {
  constexpr std::string_view kOption = "--out";
  std::vector<std::filesystem::path> folders;
  for (std::size_t i = 0; i < command.size(); ++i) {
    const std::string& word = command[i];
    if (word == kOption && i + 1 < command.size()) folders.emplace_back(command[i + 1]);
    if (word.starts_with("--out=")) folders.emplace_back(word.substr(kOption.size() + 1));
  }
  return folders;
}

}  // namespace

SessionWatch::SessionWatch(const std::filesystem::path& storage,
                           const std::vector<std::string>& command)
    : folders_(out_folders(command)) {
  folders_.push_back(storage);
  known_ = sessions();
}

std::vector<std::filesystem::path> SessionWatch::new_sessions() const {
  const std::set<std::filesystem::path> present = sessions();
  std::vector<std::filesystem::path> fresh;
  std::set_difference(present.begin(), present.end(), known_.begin(), known_.end(),
                      std::back_inserter(fresh));
  return fresh;
}

std::set<std::filesystem::path> SessionWatch::sessions() const {
  std::set<std::filesystem::path> found;
  for (const std::filesystem::path& folder : folders_) {
    std::error_code error;
    for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
         entry.increment(error))
      if (std::filesystem::exists(entry->path() / "session.json", error))
        found.insert(std::filesystem::weakly_canonical(entry->path(), error));
  }
  return found;
}

}  // namespace hw_sim
