// Does what the sequence decides: the only place where a capture touches devices.
#pragma once

#include <functional>
#include <optional>
#include <stop_token>
#include <vector>

#include "capture/captured_frame.h"
#include "capture/plan.h"
#include "capture/sequence.h"
#include "rig/camera.h"
#include "rig/event.h"
#include "rig/projector.h"
#include "rig/reopener.h"
#include "rig/rig_file.h"
#include "rig/trigger.h"

namespace capture {

// Borrowed for the length of a capture; all of them post to `events`.
struct Devices {
  rig::Projector& projector;
  rig::Trigger& trigger;
  rig::Camera& camera;
  rig::EventSource& events;
  rig::Reopener* reopener = nullptr;  // nullptr: a lost device fails the capture
};

// One call of Sequence::next(), for the journal and the progress.
struct Transition {
  rig::HostTime time;
  const SequenceEvent& event;
  std::string_view from;       // phase before
  const SequenceState& state;  // after
  const std::vector<Reacted>& reacted;
};
using OnTransition = std::function<void(const Transition&)>;

struct RunResult {
  Outcome outcome = Outcome::kFailed;
  std::optional<Failure> failure;  // when failed
  std::vector<Slot> slots;         // pattern by pattern
  int retake_count = 0;
  int restart_count = 0;
  int reopen_count = 0;
};

int retake_count(const SequenceState& state);

// The rules that a rig file implies for a plan's exposures; `refresh_hz` as the projector measured
// it. Sync mode software lacks the latency yet (capture/projector_latency.h).
SequenceRules make_rules(const rig::RigFile& rig_file,
                         const std::vector<std::chrono::microseconds>& exposures,
                         double refresh_hz);

// Without a trigger box, and without a camera that tells its line's level, the display must keep
// time. Errors: kUnsupported if it does not, with the remedy.
rig::Result<void> check_display(const Devices& devices, const LedgerRules& rules);

// Runs a plan on the calling thread, which becomes the session thread. Returns with the devices
// disarmed and the projector black (or lost), whatever happened. `stop` aborts. Refuses a display
// that check_display() refuses.
RunResult run_capture(Devices devices, const Plan& plan, const rig::ProjectorSettings& projector,
                      const SequenceRules& rules, FrameConsumer& consumer,
                      const std::stop_token& stop, const OnTransition& on_transition);

}  // namespace capture
