// `ssrig verify`: is a session whole, from its files alone?
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "estimation/session/error.h"

namespace estimation {

struct VerifyReport {
  std::string state;                 // of the manifest
  int frame_count = 0;               // frames whose file was read in full
  int checked_hash_count = 0;        // of those, with a matching sha256
  std::vector<InputError> problems;  // empty: the session is what its manifest says
  std::vector<std::string>
      notes;  // what a person may want to know, e.g. outputs that cannot be computed
};

// Reads every file the manifest names. An error only where no manifest can be read.
Result<VerifyReport> verify_session(const std::filesystem::path& session);

}  // namespace estimation
