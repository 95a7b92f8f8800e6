#include "rig/toml_text.h"

#include <algorithm>
#include <cstddef>

namespace rig {

std::string objection_to_toml(std::string_view text) {
  constexpr std::size_t kLongestText_bytes = std::size_t{1} << 20;
  constexpr std::size_t kLongestLine_bytes = 8192;
  if (text.size() > kLongestText_bytes)
    return std::string(" has ")
        .append(std::to_string(text.size()))
        .append(" bytes; expected a text of at most 1 MiB");
  for (std::size_t line = 1; !text.empty(); ++line) {
    const std::size_t length = std::min(text.find('\n'), text.size());
    if (length > kLongestLine_bytes)
      return std::string(":")
          .append(std::to_string(line))
          .append(": the line has ")
          .append(std::to_string(length))
          .append(" bytes; break it into lines of at most 8192");
    text.remove_prefix(std::min(length + 1, text.size()));
  }
  return {};
}

}  // namespace rig
