// session.json: of earlier versions, of other programs, damaged.
#include "estimation/session/manifest.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto manifest = estimation::parse_manifest(fuzz::text_of(data, size), "s/session.json");
  if (!manifest) {
    fuzz::require_message(manifest.error().text(), "s/session.json");
    return 0;
  }
  const std::string written = estimation::format_manifest(*manifest);
  const auto again = estimation::parse_manifest(written, "s/session.json");
  estimation::check(again.has_value(), "what was accepted is accepted when written again");
  estimation::check(estimation::format_manifest(*again) == written, "and stays what it is");
  return 0;
}
