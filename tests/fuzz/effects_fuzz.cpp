// A file of the virtual rig's effects (ssrig-sim run --effects).
#include "hw_sim/world/effects.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto effects = hw_sim::parse_effects(fuzz::text_of(data, size), "effects/fuzz.toml");
  if (!effects) fuzz::require_message(effects.error().detail, "effects/fuzz.toml");
  return 0;
}
