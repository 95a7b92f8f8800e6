// Texts that people write for the rig, its simulated faults and effects: read, looked at, parsed.
#pragma once

#include <toml++/toml.h>

#include <filesystem>
#include <string>
#include <string_view>

#include "rig/fault.h"

namespace rig {

// The text of a file. Errors: kConfiguration, naming the file and `remedy`, if it cannot be read or
// is no regular file. Of a text beyond all measure it returns as much as parse_toml() refuses.
Result<std::string> read_text(const std::filesystem::path& file, std::string_view remedy);

// The text's table; `file` is named in it. Errors: kConfiguration with file and line, for what is
// not TOML, and for what would take the parser apart: a dotted key makes a table of each dot, and
// toml++ takes tables apart recursively, so tens of thousands of them exhaust the stack.
Result<toml::table> parse_toml(std::string_view text, const std::filesystem::path& file);

}  // namespace rig
