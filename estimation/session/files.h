// What the system says of files, and the rule about names. Private to this folder's .cpp files.
#pragma once

#include <string>

namespace estimation {

// Why a session may not name `name`: "" if it may. Lexical only, see resolve_in_session for links.
std::string objection_to_name(const std::string& name);

// What an errno of a failed read or write means and what to do about it.
std::string explain_errno(int error_number);

}  // namespace estimation
