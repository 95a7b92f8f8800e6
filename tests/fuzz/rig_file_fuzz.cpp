// The rig file, which an operator edits.
#include "rig/rig_file.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto rig = rig::parse_rig_file(fuzz::text_of(data, size), "rigs/fuzz.toml");
  if (!rig) {
    estimation::check(rig.error().fault == rig::Fault::kConfiguration, "a rig file's own fault");
    fuzz::require_message(rig.error().detail, "rigs/fuzz.toml");
    return 0;
  }
  estimation::check(rig->camera.width_px > 0 && rig->camera.height_px > 0 &&
                        !rig->sequence.exposures.empty() &&
                        rig->trigger.threshold_low < rig->trigger.threshold_high,
                    "an accepted rig file holds what it must");
  return 0;
}
