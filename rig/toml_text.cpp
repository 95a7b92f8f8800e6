#include "rig/toml_text.h"

#include <algorithm>
#include <cstddef>
#include <fstream>
#include <system_error>

namespace rig {
namespace {

constexpr std::size_t kLongestText_bytes = std::size_t{1} << 20;

// Why the text is refused, with its line; "" if it is not.
std::string objection_to(std::string_view text) {
  constexpr std::size_t kLongestLine_bytes = 8192;
  if (text.size() > kLongestText_bytes) return " is too long; expected a text of at most 1 MiB";
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

}  // namespace

Result<std::string> read_text(const std::filesystem::path& file, std::string_view remedy) {
  const auto refuse = [&](std::string_view why) {
    return failure(Fault::kConfiguration, file.string().append(why).append("; ").append(remedy));
  };
  // Opening a folder succeeds; a pipe that nobody writes would be waited for, and a device has no
  // end.
  std::error_code unknown;
  const auto status = std::filesystem::status(file, unknown);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
    return refuse(": cannot be read, for it is no regular file");
  std::ifstream in(file, std::ios::binary);
  if (!in) return refuse(": cannot be read");
  // As much as shows that it is too long.
  std::string text(kLongestText_bytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (in.bad()) return refuse(": cannot be read");
  text.resize(static_cast<std::size_t>(in.gcount()));
  return text;
}

Result<toml::table> parse_toml(std::string_view text, const std::filesystem::path& file) {
  if (const std::string objection = objection_to(text); !objection.empty())
    return failure(Fault::kConfiguration, file.string() + objection);
  try {
    return toml::parse(text, std::string_view(file.native()));
  } catch (const toml::parse_error& error) {
    return failure(Fault::kConfiguration, file.string() + ":" +
                                              std::to_string(error.source().begin.line) +
                                              ": not TOML: " + std::string(error.description()));
  }
}

}  // namespace rig
