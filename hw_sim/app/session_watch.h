// Which session folders a command has made: those that were not there before.
#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <vector>

namespace hw_sim {

// Not thread-safe.
class SessionWatch {
 public:
  // Folders that sessions may appear in: the rig file's and the command's --out. They need not
  // exist yet.
  SessionWatch(const std::filesystem::path& storage, const std::vector<std::string>& command);

  // Folders with a session.json that have appeared since. May be called from any thread.
  std::vector<std::filesystem::path> new_sessions() const;

 private:
  std::set<std::filesystem::path> sessions() const;

  std::vector<std::filesystem::path> folders_;
  std::set<std::filesystem::path> known_;
};

}  // namespace hw_sim
