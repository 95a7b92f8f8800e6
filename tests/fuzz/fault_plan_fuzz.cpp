// A written plan of faults (ssrig-sim run --faults).
#include "hw_sim/faults/fault_plan.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::filesystem::path file("plans/fuzz.toml");
  const auto plan = hw_sim::parse_fault_plan(fuzz::text_of(data, size), file);
  if (!plan) {
    fuzz::require_message(plan.error().detail, "plans/fuzz.toml");
    return 0;
  }
  for (const hw_sim::PlannedFault& fault : plan->faults) {
    estimation::check(fault.count >= 1 && fault.rate_frac >= 0 && fault.rate_frac <= 1,
                      "an accepted fault happens, by a share of the occasions");
  }
  return 0;
}
