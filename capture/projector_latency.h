// How long a picture is on its way: from its reported swap until a frame sees it and nothing else.
// For rigs without a photodiode (sync mode software), measured when a take begins.
#pragma once

#include <chrono>
#include <stop_token>

#include "capture/runner.h"
#include "rig/projector.h"

namespace capture {

// Flips between black and white and exposes ever later after the flip, by half a refresh a step,
// until frames of both directions have the new picture's level, each time; a refresh is added,
// since swaps are reported up to a refresh late. Takes some seconds; leaves the camera disarmed and
// the projector black. `rules` are those of the take to come.
// Errors: kUnsupported (the display does not keep time; black and white look alike to the camera;
// or no delay up to twelve refreshes is enough), kTimeout (also: stopped), and those of the
// devices.
rig::Result<std::chrono::nanoseconds> measure_latency(Devices devices,
                                                      const rig::ProjectorSettings& projector,
                                                      const LedgerRules& rules,
                                                      const std::stop_token& stop);

}  // namespace capture
