// Does the display swap at its monitor's rate? Decided from measured intervals.
#pragma once

#include <string>
#include <vector>

#include "rig/projector.h"

namespace rig {

// Fills in the measured rate and whether it is the monitor's; reads the report's nominal one.
//   intervals_ms  of successive swaps, at least one
void judge_swaps(std::vector<double> intervals_ms, DisplayReport& report);

// The report as one sentence for the operator.
std::string describe(const DisplayReport& report);

}  // namespace rig
