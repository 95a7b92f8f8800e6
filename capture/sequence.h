// The order of things in a capture, as an explicit state machine. Deciding is here and pure: no
// device, no clock, no file; doing is the runner's (capture/runner.h).
//
//   Idle ─start─► Darkening ─shown─► Settling ─settled─► Arming ─armed──┐
//                    ▲ black, dark square   photodiode    box, camera    │
//                    │ at rest                                           ▼
//                    │                          ┌───────────────────► Showing ◄──────────┐
//                    │ restart                  │ a frame came          │ edge           │
//                    │ (disarm)                 │ or is given up        ▼                │
//                    └──── any of these ◄── Collecting ◄─────────── Exposing ─last pulse─┘
//                                               │ all slots filled       ended
//                                               ▼
//     any state ─abort, failure─► Blackening ◄─ Confirming
//                                     │ black shown, or its deadline
//                                     ▼
//                                   Ended (complete, failed, aborted)
//
//   sync mode software:  Showing ─swap─► Delaying ─latency: fire─► Exposing
//   pace paced:          Showing ─swap─► Pacing ─its refreshes─► the next Showing, or Collecting
//
// The first showing of a run is a priming: black under a flipped square. It wakes a camera that
// drops its first triggered frame after a rest, teaches the ledger the camera's clock, and proves,
// by all its frames having come, that camera and box count alike. Handshake pace: the next pattern
// is shown when the last pulse of this one has ended, and its frames are checked meanwhile; but
// frames of no more than two showings are ever on their way, so a slow link slows the pace.
// A lost device ends the run, not the capture: Reopening, drawn nowhere because every state of a
// run leads there, shows black and has it opened anew every half second, and goes on with
// Darkening, or fails when the device's time is up, in the midst of an opening too. A frame is
// handed on when a later picture has been shown: a projector answers a show() only while its
// monitor is as it was opened (rig/projector.h), so the light of the frame was ours. Confirming is
// that for the last pattern: black under the same square. Deadlines: every waiting state has one in
// it or, for edges, pulses and frames, in the ledger; deadline() is the earliest, and TimePassed
// makes next() look at them.
//
// Pace paced: the next picture is asked for a fixed number of refreshes after this one's swap,
// enough for its exposures; edges, pulses and frames are checked behind. The priming waits as ever.
// Where frames alone tell of edges they are handed on, besides, when the count of edges is proved
// (Ledger::is_count_proved()); with more than a few that wait for that, no picture is asked for
// until all flips on their way have been seen.
//
// Without a trigger box (LedgerRules::has_edge_per_bracket) each bracket of a pattern is a showing:
// the same picture under a flipped square, one edge, one frame, which alone tells of the edge. All
// brackets of a pattern are shown in turn, the priming's too, and whatever became of one: the
// camera's sequencer steps with the edges. A frame is handed on when the next edge has come in its
// number: then no other light was taken for a flip between. Confirming is one more flip under black
// for that, and what fails in it is held against the last pattern. In sync mode software the host
// triggers, so there is no other light: Confirming is as with a box.
//
// Where the camera does not tell the level after an edge, the display's timing must tell our flips
// (LedgerRules::relies_on_swaps): Pacing comes in pace handshake, too, so that an edge cannot pass
// for the next flip's, and pace paced is not taken up; a swap that is late and a frame that is
// damaged restart the run; and the priming pauses once, to hear an edge that is one too many.
//
// With a box a frame is handed on, besides, when one of a later pulse has come in its number: then
// no stray exposure stood for a pulse between. The last of all has none after it.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "capture/ledger.h"
#include "capture/plan.h"
#include "capture/reaction.h"
#include "rig/camera.h"
#include "rig/event.h"
#include "rig/projector.h"

namespace capture {

struct SequenceRules {
  LedgerRules ledger;
  rig::Bracketing bracketing = rig::Bracketing::kSequencer;
  int retake_limit = 3;  // per pattern
  // For a lost device to come back; 0: there is nobody to open it anew.
  std::chrono::milliseconds reopen_deadline{0};
  int reopen_limit = 3;  // per capture
  // Black and still before arming. After a run it is the edge's deadline: flips are on their way as
  // long as the display's lag, and the rig would take them for the priming's, and each flip to the
  // end for the next one's.
  std::chrono::milliseconds settle_time{100};
  // Pace paced: refreshes from the swap of each showing of a pattern to the next swap. Empty:
  // handshake.
  std::vector<int> refreshes_per_showing{};
};

// What the runner tells the sequence beside the devices' own events.
struct Start {};
struct TimePassed {};
struct AbortRequested {};
struct Armed {};
struct CommandRefused {
  rig::Device device = rig::Device::kCamera;
  rig::Error error;
};
struct Reopened {
  rig::Device device = rig::Device::kCamera;
};
struct ReopenRefused {
  rig::Device device = rig::Device::kCamera;
  rig::Error error;
};
struct StorageFailed {
  std::string text;
};
struct FrameSeen {
  FrameFacts facts;
};
using SequenceEvent =
    std::variant<Start, TimePassed, AbortRequested, Armed, CommandRefused, StorageFailed,
                 rig::PictureShown, rig::EdgeSeen, rig::PulseEnded, rig::EdgeIgnored, FrameSeen,
                 rig::FrameDamaged, rig::DeviceFault, Reopened, ReopenRefused>;
std::string_view name_of(const SequenceEvent& event);

enum class Outcome { kComplete, kFailed, kAborted };

struct Failure {
  Incident incident = Incident::kFrameMissing;
  std::optional<rig::Device> device;  // at fault, where one is
  std::vector<SlotId> slots;          // open, each with an incident of its own
  std::string text;                   // one sentence with the remedy
};

struct Idle {};
struct Darkening {
  std::uint64_t show_id = 0;
  rig::HostTime deadline;
};
struct Settling {
  rig::HostTime deadline;  // when it has settled
};
struct Arming {
  rig::HostTime deadline;
};
// The ledger has the deadlines of edges, pulses and frames.
struct Showing {};
struct Exposing {};
struct Delaying {  // the picture is on its way through the projector
  rig::HostTime fire_at;
};
struct Pacing {
  rig::HostTime next_show;
};
struct Collecting {};
struct Confirming {
  std::uint64_t show_id = 0;
  rig::HostTime deadline = rig::HostTime::max();  // of black; what else is awaited has its own
};
struct Reopening {
  std::vector<rig::Device> lost;  // the first is being opened
  bool is_trying = true;          // else waiting for the next try
  rig::HostTime next_try;
  rig::HostTime give_up;
  std::string cause;  // why it is lost, or was not opened the last time
};
struct Blackening {
  std::uint64_t show_id = 0;
  rig::HostTime deadline;
};
struct Ended {};
using Phase = std::variant<Idle, Darkening, Settling, Arming, Showing, Delaying, Exposing, Pacing,
                           Collecting, Confirming, Reopening, Blackening, Ended>;
std::string_view name_of(const Phase& phase);

struct KeepFrame {
  std::uint64_t ticket = 0;
  SlotId slot;
  Evidence evidence;
};

struct SequenceState {
  Phase phase;
  Ledger ledger;
  std::deque<int> queue{};  // patterns still to show, next first
  // [pattern + 1], held against the limit. The first is the priming's, since one last succeeded: a
  // capture may need many, as long as each gets its way.
  std::vector<int> retake_counts{};
  int retake_total = 0;
  int restart_count = 0;
  int reopen_count = 0;
  std::uint32_t run_id = 0;  // of the latest arming
  std::uint64_t next_show_id = 1;
  std::uint64_t shown_show_id = 0;       // the newest that was answered
  std::vector<KeepFrame> unconfirmed{};  // good, but not to be handed on yet
  bool is_square_light = false;
  std::uint64_t dark_show_id = 0;           // of black under a dark square, the latest picture
  std::optional<rig::HostTime> darkened{};  // when that was first shown, nothing else since
  bool has_listened = false;                // in this run, see listens()
  bool is_priming_retaken = false;          // in this run
  Outcome outcome = Outcome::kFailed;       // once Blackening or Ended
  std::optional<Failure> failure{};
};

// What the runner is to do, in order.
struct Show {
  rig::ShowRequest request;
};
struct Arm {  // camera first: the box must not fire into a camera that does not listen
  std::uint32_t run_id = 0;
  int frame_count = 0;
};
struct Fire {};    // one exposure, now
struct Disarm {};  // box first; frames not kept so far are let go
struct Reopen {    // answered by Reopened or ReopenRefused
  rig::Device device = rig::Device::kCamera;
};
struct DropFrame {
  std::uint64_t ticket = 0;
};
using Action = std::variant<Show, Arm, Fire, Disarm, Reopen, KeepFrame, DropFrame>;

struct Reacted {
  Finding finding;
  Reaction reaction = Reaction::kIgnore;
};

struct Step {
  SequenceState state;
  std::vector<Action> actions;
  std::vector<Reacted> reacted;  // for the journal
};

class Sequence {
 public:
  Sequence(SequenceRules rules, std::vector<int> order);  // of projection, each pattern once

  SequenceState initial() const;
  // `now` never goes back. The state is taken by value: move it in.
  Step next(SequenceState state, const SequenceEvent& event, rig::HostTime now) const;
  // When to call next() with TimePassed, should nothing happen before; nullopt in Idle and Ended.
  static std::optional<rig::HostTime> deadline(const SequenceState& state);

 private:
  SequenceRules rules_;
  std::vector<int> order_;
};

}  // namespace capture
