// Plans of faults drawn from a seed.
#pragma once

#include <random>

#include "hw_sim/faults/fault_plan.h"
#include "tests/capture/ledger_rig.h"

namespace capture {

// Up to seven faults of any kind anywhere in a capture.
inline hw_sim::FaultPlan random_plan(std::mt19937_64& random) {
  hw_sim::FaultPlan plan{.seed = random(), .faults = {}};
  for (std::uint64_t k = random() % 8; k > 0; --k) {
    const auto kind = static_cast<hw_sim::FaultKind>(random() % hw_sim::kFaultKindCount);
    auto fault = fault_at(kind, static_cast<int>(random() % 90), static_cast<int>(random() % 2),
                          1 + static_cast<int>(random() % 2));
    // A ramp that is bent and put back between two looks, that is within one pattern, nobody sees.
    const unsigned shortest_ms = kind == hw_sim::FaultKind::kGammaWrong ? 100 : 1;
    if (fault.duration.count() > 0)
      fault.duration = std::chrono::milliseconds(shortest_ms + random() % 2000);
    if (random() % 8 == 0) {
      fault.place.reset();
      fault.rate_frac = 0.003;
      fault.count = 5;
    }
    plan.faults.push_back(fault);
  }
  return plan;
}

}  // namespace capture
