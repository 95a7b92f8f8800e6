// What a client takes from whatever answers on the daemon's port.
#include "capture/daemon/state_board.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto snapshot = capture::parse_snapshot(fuzz::text_of(data, size));
  if (!snapshot) return 0;
  const std::string written = capture::to_json(*snapshot);
  const auto again = capture::parse_snapshot(written);
  estimation::check(again && capture::to_json(*again) == written,
                    "a snapshot comes back as it was sent");
  return 0;
}
