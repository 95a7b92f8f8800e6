// Whole files in and out of memory, and the rule about names. Private to this folder's .cpp files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "estimation/session/error.h"

namespace estimation {

// Why a session may not name `name`: "" if it may. Lexical only, see resolve_in_session for links.
std::string objection_to_name(const std::string& name);

// Errors: kNotFound; kUnreadable for what is not permitted, is no regular file (a pipe would hang),
// or has more than `max_byte_count` bytes.
Result<std::vector<std::byte>> read_file(const std::filesystem::path& path,
                                         std::uint64_t max_byte_count);

// What an errno of a failed read or write means and what to do about it.
std::string explain_errno(int error_number);

}  // namespace estimation
