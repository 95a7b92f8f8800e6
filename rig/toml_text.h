// What is looked at before a text goes to the TOML parser.
#pragma once

#include <string>
#include <string_view>

namespace rig {

// Why the text is refused, with its line; "" if it is not. A dotted key makes a table of each dot,
// and toml++ takes tables apart recursively: tens of thousands of them exhaust the stack.
std::string objection_to_toml(std::string_view text);

}  // namespace rig
