// A session taken of ssrig-sim's scene "ledger", held against what its frames say of themselves.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

struct LedgerSession {
  std::string state;  // of the manifest; empty: none could be read
  int frame_count = 0;
  std::vector<std::string> wrong_frames;  // file and what is wrong with it
};

// `rig_file` is the rig file that it was taken with.
LedgerSession read_ledger_session(const std::filesystem::path& session,
                                  const std::filesystem::path& rig_file);
