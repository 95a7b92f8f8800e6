// The ledger: what has been proved about every frame of a plan. A slot is filled only when all its
// evidence agrees; a frame is never assigned by the order in which it arrived.
//
// One pattern's evidence, in the order of its making:
//   show ─► PictureShown(show id, swap time) ─► EdgeSeen(level, time) ─► PulseEnded x brackets
//        ─► frame: its number (trigger count chunk, else block id) names a pulse; its timestamp,
//           through a clock map learnt in this run, must be that pulse's start; its exposure chunk
//           must be that bracket's.
// Without a trigger box each bracket is a showing of its own: one edge, one pulse, one frame, all
// of them told by the camera (rig/camera_trigger.h). Then its count of edges and the line's level
// at the begin of each frame are the proof. In pace handshake they suffice however late the display
// is: no flip is asked for before the frame of the last one, so the light is that flip's or an
// earlier one's; the frame before proves that the last flip was shown, and the level that this one
// was. The time of the edge says the rest: not before its picture was asked for, and as long after
// the swap as in the priming (capture/swap_lag.h): no other light took the flip's place.
// In pace paced later flips are on their way while a frame comes. Two of them that nobody saw leave
// the levels as they are, and a camera's clock that steps back by as much leaves the times; but
// then frames come that much later, by the host's clock. A frame that is as prompt as those before
// proves the count up to itself, and so do flips that have all been seen.
// From a camera that does not tell the level (LedgerRules::relies_on_swaps) times are all there is,
// and then the display must keep time: swaps that are late are findings, too.
//
// Plain data and decisions; no device, no clock of its own. Copyable. What devices tell is taken in
// in ledger_evidence.cpp, frames are decided about in ledger_verdicts.cpp.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "capture/reaction.h"
#include "capture/swap_lag.h"
#include "rig/camera.h"
#include "rig/clock.h"
#include "rig/event.h"

namespace capture {

// Stands for a pattern where the showing is one of ours: black, to wake the camera and to learn its
// clock; its frames fill no slot.
inline constexpr int kPrimePattern = -1;
inline constexpr int kNoBracket = -1;

struct LedgerRules {
  std::vector<std::chrono::microseconds> exposures;  // [bracket], shortest first
  std::chrono::microseconds gap{5000};               // between pulses, as the trigger box is set
  std::chrono::microseconds debounce{2000};          // edges so soon after another are bounces
  std::chrono::nanoseconds refresh_interval{16'666'667};
  // From hearing of a pulse's end, or the frame before, to its frame.
  std::chrono::milliseconds frame_deadline{1000};
  // From asking for a picture to its edge, and from hearing of that, beyond their lengths, to its
  // pulses' ends.
  std::chrono::milliseconds edge_deadline{500};
  // Each bracket is a showing of its own, whose frame alone tells of its edge and pulse.
  bool has_edge_per_bracket = false;
  // An edge must come as long after its swap as in the priming: else it is not known to be ours.
  bool is_lag_checked = false;
  // The level after an edge is not told, so that only the display's timing tells our flips.
  bool relies_on_swaps = false;
  int priming_rounds = 1;  // of all brackets
  // Sync mode software: how long after the swap the host triggers. There is no edge but that.
  std::optional<std::chrono::nanoseconds> latency{};

  int brackets_per_showing() const {
    return has_edge_per_bracket ? 1 : static_cast<int>(exposures.size());
  }

  // Between a frame's timestamp and its pulse: less than half the way to the next pulse, so that
  // no frame can pass for its neighbour; and, where pulses are far apart, less than from a stray
  // exposure to the pulse that it leaves the camera no time for. Clocks are known far better.
  std::chrono::nanoseconds time_tolerance() const {
    return std::min<std::chrono::nanoseconds>((exposures.front() + gap) / 2,
                                              std::chrono::milliseconds(2));
  }
};

// What the ledger must know of a frame; the pixels stay with the runner, under `ticket`.
struct FrameFacts {
  std::uint64_t ticket = 0;
  std::uint64_t block_id = 0;
  rig::CameraClock::time_point timestamp;
  rig::HostTime received;
  std::optional<std::chrono::microseconds> exposure;
  std::optional<std::uint64_t> trigger_count;

  // The pulse since arming that it claims to be of. Without the counter chunk the block id must do:
  // then a trigger that the camera missed shows in the timestamp.
  std::uint64_t pulse_number() const { return trigger_count.value_or(block_id); }
};

struct Evidence {
  std::uint64_t show_id = 0;
  rig::HostTime swapped;
  std::uint32_t edge_number = 0;
  bool is_light = false;
  rig::HostTime edge;
  std::uint32_t pulse_number = 0;
  rig::HostTime pulse_started, pulse_ended;
  std::uint64_t block_id = 0;
  rig::CameraClock::time_point camera_timestamp;
  std::optional<std::chrono::microseconds> exposure;  // as the camera says
};

// A picture that is asked for, and what of its pattern it is to expose.
struct Flip {
  int pattern = kPrimePattern;
  int first_bracket = 0;
  std::uint64_t show_id = 0;
  bool is_light = false;
  rig::HostTime requested;
};

struct Slot {
  SlotId id;
  std::optional<Evidence> evidence;       // filled
  std::optional<Incident> last_incident;  // what went wrong with it last
};

// Something wrong, and where: the pattern whose showing it concerns.
struct Finding {
  Incident incident = Incident::kFrameMissing;
  int pattern = kPrimePattern;
  int bracket = kNoBracket;
  std::string detail;         // one clause with the numbers
  std::uint64_t show_id = 0;  // of the showing, where one is concerned
};
using Findings = std::vector<Finding>;

// What becomes of a frame: it fills `slot`, or it is given back.
struct Verdict {
  std::uint64_t ticket = 0;
  std::optional<SlotId> slot;
  Evidence evidence;
};

class Ledger {
 public:
  Ledger(LedgerRules rules, int pattern_count);

  // Devices were armed anew: numbers start at 1, the camera's clock is unknown. Slots stay filled;
  // frames held are forgotten (the runner lets go of theirs when it disarms).
  void start_run();

  // A picture has been asked for; its edge, pulses and frames are awaited.
  void open_showing(const Flip& flip);

  [[nodiscard]] Findings picture_shown(const rig::PictureShown& shown);
  [[nodiscard]] Findings edge_seen(const rig::EdgeSeen& edge, rig::HostTime now);
  [[nodiscard]] Findings edge_ignored(const rig::EdgeIgnored& edge);
  [[nodiscard]] Findings pulse_ended(const rig::PulseEnded& pulse, rig::HostTime now);
  [[nodiscard]] Findings frame_damaged(const rig::FrameDamaged& damaged);
  void frame_seen(const FrameFacts& facts, rig::HostTime now);

  // Decides about the frames that can be decided about: those whose showing is over.
  std::vector<Verdict> judge(Findings& findings);

  // Edges, pulses and frames overdue at `now`, and frames whose pulse never became known.
  [[nodiscard]] Findings expire(rig::HostTime now);
  std::optional<rig::HostTime> next_due() const;

  // The showing under way, or the last one.
  int showing_pattern() const;
  int showing_bracket() const;  // its first
  std::optional<rig::HostTime> swapped() const;
  bool has_edge() const;
  bool is_showing_over() const;  // all its pulses have ended
  // The bracket that the last showing's pattern still lacks a showing of; kNoBracket: none.
  int next_bracket() const;
  // The newest showing that edge and swap agree about; 0: none yet.
  std::uint64_t proved_show_id() const;
  // The newest pulse of this run whose frame was found good: camera and box counted alike up to
  // it. 0: none yet.
  std::uint32_t proved_pulse_number() const { return proved_pulse_number_; }
  // Where edges are told by frames: is the count of edges proved up to that pulse?
  bool is_count_proved(std::uint32_t pulse_number) const;
  // Gives up on a showing: none of its frames will count.
  void spoil_showing(std::uint64_t show_id);
  bool is_spoiled(std::uint64_t show_id) const;
  // Has the pattern had a showing after that one, or has it one now?
  bool is_shown_again(int pattern, std::uint64_t show_id) const;

  // Showings whose pulses have not all ended, or whose frames are still awaited.
  int open_showing_count() const;
  // All frames of a priming came, each with its number: the camera counts as the box does.
  bool is_primed() const { return is_primed_; }

  bool is_filled(int pattern) const;
  bool is_filled(SlotId id) const;
  int filled_count() const { return filled_count_; }
  bool is_complete() const { return filled_count_ == static_cast<int>(slots_.size()); }
  const std::vector<Slot>& slots() const { return slots_; }  // pattern by pattern
  // Its frame is not to be used after all.
  void empty(SlotId id);
  void note(const Finding& finding);  // remembers the cause at the open slots it concerns

 private:
  struct Showing {
    Flip flip;
    rig::HostTime due;  // of the edge, then of the last pulse's end
    std::optional<rig::HostTime> swapped;
    std::optional<rig::EdgeSeen> edge;
    bool is_edge_lost = false;   // with the frame that would have told of it
    bool is_level_gone = false;  // a bounce of the edge that did not come back
    int ended_pulse_count = 0;
    bool is_spoiled = false;
  };
  enum class Wait { kAwaited, kArrived, kGivenUp };
  struct Pulse {
    std::size_t showing = 0;
    int bracket = 0;
    rig::HostTime started, ended, frame_due;
    Wait wait = Wait::kAwaited;
  };
  struct Held {
    FrameFacts facts;
    rig::HostTime due;  // by when its pulse must be known
  };

  static std::string in_us(std::chrono::nanoseconds time);
  void note_promptness(const FrameFacts& facts, const Pulse& pulse);
  bool is_over(const Showing& showing) const;
  bool is_settled(const Showing& showing) const;
  Showing* without_edge();
  Showing* under_exposure();
  const Showing* find(std::uint64_t show_id) const;
  Findings lose_edge(const rig::FrameDamaged& damaged);
  std::chrono::nanoseconds train_length(const Showing& showing) const;
  bool is_decidable(const FrameFacts& facts) const;
  Verdict decide(const FrameFacts& facts, Findings& findings);
  std::optional<Finding> contradiction(const FrameFacts& facts, const Pulse& pulse) const;
  Findings check_swap(const Showing& showing) const;
  Findings check_flip(const Showing& showing);
  Findings check_lag(const Showing& showing);
  Findings check_latency(const Showing& showing) const;
  Slot& slot(SlotId id);
  Evidence evidence_of(const FrameFacts& facts, const Pulse& pulse) const;
  Finding about(const Showing& showing, Incident incident, std::string detail) const;
  Finding about_last_showing(Incident incident, std::string detail) const;

  LedgerRules rules_;
  std::vector<Slot> slots_;
  int filled_count_ = 0;
  // This run's.
  std::vector<Showing> showings_;
  std::vector<Pulse> pulses_;  // [pulse number - 1]
  std::vector<Held> held_;
  rig::ClockMap<rig::CameraClock> camera_clock_;
  std::uint32_t last_edge_number_ = 0;
  std::uint32_t proved_pulse_number_ = 0;
  std::optional<std::chrono::nanoseconds> least_delay_;  // from a pulse's end to its frame
  std::uint32_t prompt_pulse_number_ = 0;                // the newest whose frame came so soon
  SwapLag lag_;
  int primed_frame_count_ = 0;  // of the priming under way, or the last one
  bool is_priming_spoiled_ = false;
  bool is_primed_ = false;
};

}  // namespace capture
