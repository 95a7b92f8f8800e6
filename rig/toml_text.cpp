#include "rig/toml_text.h"

#include <algorithm>
#include <cstddef>
#include <fstream>
#include <iterator>
#include <system_error>

namespace rig {
namespace {

// Why the text is refused, with its line; "" if it is not.
std::string objection_to(std::string_view text) {
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

}  // namespace

Result<std::string> read_text(const std::filesystem::path& file, std::string_view remedy) {
  std::ifstream in(file, std::ios::binary);
  std::error_code unknown;                                    // then reading says why
  if (!in || std::filesystem::is_directory(file, unknown)) {  // reading a folder throws
    return failure(Fault::kConfiguration,
                   file.string().append(": cannot be read; ").append(remedy));
  }
  std::string text((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  if (in.bad()) return failure(Fault::kConfiguration, file.string() + ": is not a readable file");
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
