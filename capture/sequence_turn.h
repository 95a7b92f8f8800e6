// One call of Sequence::next(): the step in the making. What it takes in is in
// sequence_events.cpp, how it reacts in sequence_reactions.cpp, how it goes on in
// sequence_progress.cpp. Internal to the sequence.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/sequence.h"

namespace capture {

template <typename... Handlers>
struct Overloaded : Handlers... {
  using Handlers::operator()...;
};
template <typename... Handlers>
Overloaded(Handlers...) -> Overloaded<Handlers...>;

bool is_running(const Phase& phase);  // a run, from its priming on
bool is_over(const Phase& phase);     // the capture

class Turn {
 public:
  Turn(const SequenceRules& rules, const std::vector<int>& order, SequenceState state,
       rig::HostTime now)
      : rules_(rules), order_(order), now_(now), step_{std::move(state), {}, {}} {}

  Step run(const SequenceEvent& event) &&;

 private:
  SequenceState& state() { return step_.state; }
  Ledger& ledger() { return step_.state.ledger; }

  // Taking in what happened.
  void take(const Start&);
  void take(const TimePassed&) {}
  void take(const AbortRequested&);
  void take(const Armed&);
  void take(const CommandRefused& refused);
  void take(const rig::DeviceFault& fault);
  void take(const StorageFailed& failed);
  void take(const rig::PictureShown& shown);
  void take(const rig::EdgeSeen& edge);
  void take(const rig::EdgeIgnored& edge);
  void take(const rig::PulseEnded& pulse);
  void take(const FrameSeen& frame);
  void take(const rig::FrameDamaged& damaged);
  void take_device_error(rig::Device device, const rig::Error& error);
  bool may_reopen();
  void reopen(const Finding& finding, rig::Device device);
  void take(const Reopened& reopened);
  void take(const ReopenRefused& refused);
  void give_up(const Reopening& reopening);
  void judge_frames();
  void keep(const KeepFrame& frame);
  bool is_confirmed(const KeepFrame& frame);
  bool is_counted(const KeepFrame& frame);
  void confirm_anew();
  rig::HostTime settled_at();
  void confirm(std::uint64_t show_id);
  bool is_confirmed_by_edge() const;
  void confirm_by_edge();
  void discard_unconfirmed();

  // Reacting, by the table of reaction.h.
  void look_at_deadlines();
  void look_at_reopening();
  std::optional<Finding> overdue_by(rig::HostTime deadline, Incident incident, std::string detail);
  void react(const Findings& findings);
  Finding charged(Finding finding);
  Reaction reaction_here(const Finding& finding);
  bool is_queued(int pattern);
  void retake(const Finding& finding);
  bool count_retake(const Finding& finding);
  void restart();
  void fail(const Finding& finding, std::optional<rig::Device> device, std::string text);

  // Going on.
  void proceed();
  void wait_for_the_showing();
  bool is_paced() { return !rules_.refreshes_per_showing.empty() && ledger().is_primed(); }
  std::chrono::nanoseconds pace();
  void fire();
  bool is_too_early();
  bool must_drain();
  bool listens();
  void show_next();
  void confirm_last();
  void darken();
  void arm();
  void show(int pattern, int first_bracket);
  void end(Outcome outcome);
  std::uint64_t ask_for(int picture);

  const SequenceRules& rules_;
  const std::vector<int>& order_;
  const rig::HostTime now_;
  Step step_;
};

}  // namespace capture
