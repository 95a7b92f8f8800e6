#include "capture/sequence.h"

#include <algorithm>
#include <utility>

#include "capture/sequence_turn.h"

namespace capture {

bool is_running(const Phase& phase) {
  return std::holds_alternative<Showing>(phase) || std::holds_alternative<Delaying>(phase) ||
         std::holds_alternative<Exposing>(phase) || std::holds_alternative<Pacing>(phase) ||
         std::holds_alternative<Collecting>(phase) || std::holds_alternative<Confirming>(phase);
}

bool is_over(const Phase& phase) {
  return std::holds_alternative<Blackening>(phase) || std::holds_alternative<Ended>(phase);
}

Sequence::Sequence(SequenceRules rules, std::vector<int> order)
    : rules_(std::move(rules)), order_(std::move(order)) {}

SequenceState Sequence::initial() const {
  const int pattern_count = static_cast<int>(order_.size());
  SequenceState state{Idle{}, Ledger(rules_.ledger, pattern_count)};
  state.retake_counts.assign(static_cast<std::size_t>(pattern_count) + 1, 0);
  return state;
}

Step Sequence::next(SequenceState state, const SequenceEvent& event, rig::HostTime now) const {
  return Turn(rules_, order_, std::move(state), now).run(event);
}

std::optional<rig::HostTime> Sequence::deadline(const SequenceState& state) {
  std::optional<rig::HostTime> due = std::visit(
      Overloaded{[](const Idle&) { return std::optional<rig::HostTime>(); },
                 [](const Ended&) { return std::optional<rig::HostTime>(); },
                 [](const Showing&) { return std::optional<rig::HostTime>(); },
                 [](const Exposing&) { return std::optional<rig::HostTime>(); },
                 [](const Collecting&) { return std::optional<rig::HostTime>(); },
                 [](const Delaying& delaying) { return std::optional(delaying.fire_at); },
                 [](const Pacing& pacing) { return std::optional(pacing.next_show); },
                 [](const Reopening& reopening) {
                   return std::optional(reopening.is_trying
                                            ? reopening.give_up
                                            : std::min(reopening.next_try, reopening.give_up));
                 },
                 [](const auto& waiting) { return std::optional(waiting.deadline); }},
      state.phase);
  if (is_running(state.phase)) {
    const auto frame_due = state.ledger.next_due();
    if (frame_due && (!due || *frame_due < *due)) due = frame_due;
  }
  return due;
}

std::string_view name_of(const Phase& phase) {
  constexpr std::string_view kNames[] = {
      "idle",   "darkening",  "settling",   "arming",    "showing",    "delaying", "exposing",
      "pacing", "collecting", "confirming", "reopening", "blackening", "ended"};
  static_assert(std::size(kNames) == std::variant_size_v<Phase>);
  return kNames[phase.index()];
}

std::string_view name_of(const SequenceEvent& event) {
  constexpr std::string_view kNames[] = {
      "start",          "time passed",   "abort requested", "armed",       "command refused",
      "storage failed", "picture shown", "edge seen",       "pulse ended", "edge ignored",
      "frame seen",     "frame damaged", "device fault",    "reopened",    "reopen refused"};
  static_assert(std::size(kNames) == std::variant_size_v<SequenceEvent>);
  return kNames[event.index()];
}

}  // namespace capture
