// The journal's line for one step of the sequence.
#pragma once

#include <string>

#include "capture/runner.h"

namespace capture {

// One JSON object: time since `start`, event, phases, pattern, and what was found and done.
std::string journal_line(const Transition& transition, rig::HostTime start);

}  // namespace capture
