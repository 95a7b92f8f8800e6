// A request to the daemon: three lines (Host, Origin, Content-Type), then the body. Which headers
// and bodies httplib makes of a socket's bytes is its own.
#include <array>
#include <filesystem>

#include "capture/daemon/http_request.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest = fuzz::text_of(data, size);
  std::array<std::string, 3> headers;
  for (std::string& header : headers) {
    const std::size_t end = rest.find('\n');
    header = rest.substr(0, end);
    rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
  }
  const auto& [host, origin, content_type] = headers;
  const bool is_own = capture::is_own_origin(host, origin.empty() ? nullptr : &origin, 8640);
  estimation::check(!is_own || host.ends_with(":8640"), "only this daemon's own pages are served");
  const auto command = capture::parse_command(content_type, rest);
  if (!command) {
    estimation::check((command.error().status == 400 || command.error().status == 415) &&
                          !command.error().text.empty(),
                      "a refusal says why");
    return 0;
  }
  estimation::check(
      !command->request_id.empty() && command->request_id.size() <= 200 &&
          command->subject.size() <= 200 &&
          (command->directory.empty() || std::filesystem::path(command->directory).is_absolute()),
      "an accepted command is within its limits");
  return 0;
}
