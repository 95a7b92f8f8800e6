#include "capture/sequence.h"

#include <algorithm>
#include <utility>

#include "estimation/base/check.h"

namespace capture {
namespace {

using std::chrono::milliseconds;

// Arming talks to two devices and reads every setting back: a dead camera takes 2.5 s to say so.
constexpr milliseconds kArmDeadline{10'000};
constexpr milliseconds kBlackDeadline{500};
constexpr milliseconds kReopenPeriod{500};
// Frames of no more showings than that are on their way at a time.
constexpr int kOpenShowingLimit = 2;
constexpr int kPacedShowingLimit = 6;

template <typename... Handlers>
struct Overloaded : Handlers... {
  using Handlers::operator()...;
};
template <typename... Handlers>
Overloaded(Handlers...) -> Overloaded<Handlers...>;

bool is_running(const Phase& phase) {
  return std::holds_alternative<Showing>(phase) || std::holds_alternative<Delaying>(phase) ||
         std::holds_alternative<Exposing>(phase) || std::holds_alternative<Pacing>(phase) ||
         std::holds_alternative<Collecting>(phase) || std::holds_alternative<Confirming>(phase);
}

bool is_over(const Phase& phase) {
  return std::holds_alternative<Blackening>(phase) || std::holds_alternative<Ended>(phase);
}

std::string name_of_pattern(int pattern) {
  return pattern == kPrimePattern ? "the priming" : "pattern " + std::to_string(pattern);
}

// What a person can do about an incident that retakes did not cure.
std::string_view remedy(Incident incident) {
  switch (incident) {
    case Incident::kPictureNotShown:
      return "see that the monitor is on and its refresh is not blocked";
    case Incident::kPictureLate:
      return "see that vertical sync is on and nothing else loads the computer or its graphics";
    case Incident::kEdgeMissing:
      return "see that the photodiode sits on the sync square and its thresholds fit";
    case Incident::kEdgeWrongLevel:
      return "see that projector.sync_inverted fits the photodiode, and shade it from other light";
    case Incident::kEdgeBeforeFlip:
    case Incident::kEdgeLate:
    case Incident::kEdgeDuringExposure:
    case Incident::kEdgeOutOfOrder:
      return "shade the photodiode from other light, or lengthen trigger.debounce_us (without a "
             "box "
             "camera.line_debounce_us)";
    case Incident::kPulseMissing:
    case Incident::kPulseOutOfOrder:
    case Incident::kDataLost:
      return "plug the trigger box straight into the host";
    case Incident::kFrameMissing:
    case Incident::kFrameUnexpected:
    case Incident::kFrameMistimed:
      return "lengthen trigger.gap_us beyond the camera's readout, or see to the trigger cable";
    case Incident::kFrameDamaged:
    case Incident::kFrameDuplicate:
    case Incident::kFrameLate:
      return "see to the camera's network: own interface, jumbo frames, larger socket buffers";
    case Incident::kFrameMisexposed:
      return "the camera missed a trigger: lengthen trigger.gap_us beyond its readout, see to the "
             "trigger cable, or use trigger_width";
    case Incident::kDeviceRefused:
    case Incident::kDeviceLost:
    case Incident::kStorage:
      break;
  }
  return "put the cause right and start again";
}

// One call of next(): the step in the making.
class Turn {
 public:
  Turn(const SequenceRules& rules, const std::vector<int>& order, SequenceState state,
       rig::HostTime now)
      : rules_(rules), order_(order), now_(now), step_{std::move(state), {}, {}} {}

  Step run(const SequenceEvent& event) && {
    std::visit([this](const auto& e) { take(e); }, event);
    judge_frames();
    look_at_deadlines();
    proceed();
    return std::move(step_);
  }

 private:
  SequenceState& state() { return step_.state; }
  Ledger& ledger() { return step_.state.ledger; }

  // Taking in what happened.
  void take(const Start&) {
    if (std::holds_alternative<Idle>(state().phase)) darken();
  }
  void take(const TimePassed&) {}
  void take(const AbortRequested&) {
    if (!is_over(state().phase)) end(Outcome::kAborted);
  }
  void take(const Armed&) {
    if (!std::holds_alternative<Arming>(state().phase)) return;
    ledger().start_run();
    state().is_priming_retaken = false;
    state().phase = Collecting{};  // nothing is awaited yet: proceed() shows the priming
  }
  void take(const CommandRefused& refused) { take_device_error(refused.device, refused.error); }
  void take(const rig::DeviceFault& fault) {
    // Between runs only a lost device matters: the rest is of a run that is given up.
    if (is_running(state().phase) || incident_of(fault.error.fault) == Incident::kDeviceLost ||
        incident_of(fault.error.fault) == Incident::kDeviceRefused)
      take_device_error(fault.device, fault.error);
  }
  void take(const StorageFailed& failed) {
    react({{Incident::kStorage, ledger().showing_pattern(), kNoBracket, failed.text}});
  }
  void take(const rig::PictureShown& shown) {
    if (const auto* darkening = std::get_if<Darkening>(&state().phase)) {
      if (darkening->show_id == shown.show_id) state().phase = Settling{now_ + rules_.settle_time};
    } else if (const auto* blackening = std::get_if<Blackening>(&state().phase)) {
      if (blackening->show_id == shown.show_id) state().phase = Ended{};
    } else if (is_running(state().phase)) {
      if (!is_confirmed_by_edge()) confirm(shown.show_id);
      react(ledger().picture_shown(shown));
      confirm_by_edge();
    }
  }
  void take(const rig::EdgeSeen& edge) {
    if (!is_running(state().phase)) return;
    react(ledger().edge_seen(edge));
    confirm_by_edge();
  }
  void take(const rig::EdgeIgnored& edge) {
    if (is_running(state().phase)) react(ledger().edge_ignored(edge));
  }
  void take(const rig::PulseEnded& pulse) {
    if (is_running(state().phase)) react(ledger().pulse_ended(pulse, now_));
  }
  void take(const FrameSeen& frame) {
    if (is_running(state().phase))
      ledger().frame_seen(frame.facts, now_);
    else
      step_.actions.push_back(DropFrame{frame.facts.ticket});
  }
  void take(const rig::FrameDamaged& damaged) {
    if (is_running(state().phase)) react(ledger().frame_damaged(damaged));
  }

  void take_device_error(rig::Device device, const rig::Error& error) {
    if (is_over(state().phase)) return;
    const Finding finding{incident_of(error.fault), ledger().showing_pattern(), kNoBracket,
                          error.detail};
    const Reaction reaction = reaction_to(finding.incident, rules_.bracketing);
    if (reaction != Reaction::kFail && reaction != Reaction::kReopen) return react({finding});
    // A window whose X server is gone cannot be made again in this process.
    const bool is_final =
        device == rig::Device::kProjector && error.fault == rig::Fault::kDeviceLost;
    if (reaction == Reaction::kReopen && !is_final && may_reopen()) return reopen(finding, device);
    step_.reacted.push_back({finding, Reaction::kFail});
    fail(finding, device, std::string(to_string(device)) + ": " + error.detail);
  }

  // A window's X server aside, any device that was lost, a bounded number of times.
  bool may_reopen() {
    return rules_.reopen_deadline.count() > 0 &&
           (std::holds_alternative<Reopening>(state().phase) ||
            state().reopen_count < rules_.reopen_limit);
  }

  void reopen(const Finding& finding, rig::Device device) {
    ledger().note(finding);
    if (auto* reopening = std::get_if<Reopening>(&state().phase)) {
      auto& lost = reopening->lost;
      if (std::find(lost.begin(), lost.end(), device) == lost.end()) lost.push_back(device);
      return;
    }
    step_.reacted.push_back({finding, Reaction::kReopen});
    ++state().reopen_count;
    discard_unconfirmed();
    // It may take long, and nobody should look into a pattern meanwhile. A projector that is lost
    // is black by itself.
    state().is_square_light = false;
    if (device != rig::Device::kProjector) ask_for(rig::kBlackPicture);
    state().phase = Reopening{{device}, true, now_, now_ + rules_.reopen_deadline, finding.detail};
    step_.actions.push_back(Reopen{device});  // first, for a dead device takes seconds to disarm
    step_.actions.push_back(Disarm{});
  }

  void take(const Reopened& reopened) {
    auto* reopening = std::get_if<Reopening>(&state().phase);
    if (reopening == nullptr) return;
    std::erase(reopening->lost, reopened.device);
    if (reopening->lost.empty()) {
      // What the loss spoilt until it was noticed is not the patterns' fault.
      std::fill(state().retake_counts.begin(), state().retake_counts.end(), 0);
      return darken();
    }
    step_.actions.push_back(Reopen{reopening->lost.front()});
  }

  void take(const ReopenRefused& refused) {
    auto* reopening = std::get_if<Reopening>(&state().phase);
    if (reopening == nullptr) return;
    reopening->is_trying = false;
    reopening->next_try = now_ + kReopenPeriod;
    reopening->cause = refused.error.detail;
  }

  void give_up(const Reopening& reopening) {
    const rig::Device device = reopening.lost.front();
    const Finding finding{Incident::kDeviceLost, ledger().showing_pattern(), kNoBracket,
                          reopening.cause};
    step_.reacted.push_back({finding, Reaction::kFail});
    fail(finding, device,
         std::string(to_string(device)) + ": lost, and not back within " +
             std::to_string(rules_.reopen_deadline.count() / 1000) + " s: " + finding.detail);
  }

  void judge_frames() {
    if (!is_running(state().phase)) return;
    Findings findings;
    for (const Verdict& verdict : ledger().judge(findings)) {
      if (verdict.slot)
        keep({verdict.ticket, *verdict.slot, verdict.evidence});
      else
        step_.actions.push_back(DropFrame{verdict.ticket});
    }
    react(findings);
  }

  void keep(const KeepFrame& frame) {
    if (frame.evidence.show_id < state().shown_show_id)
      step_.actions.push_back(frame);
    else
      state().unconfirmed.push_back(frame);
  }

  // The display was as opened when picture `show_id` was drawn, so those before it were what we
  // meant.
  void confirm(std::uint64_t show_id) {
    state().shown_show_id = std::max(state().shown_show_id, show_id);
    for (const KeepFrame& frame : std::exchange(state().unconfirmed, {})) keep(frame);
  }

  // Where a stray trigger could be taken for a flip.
  bool is_confirmed_by_edge() const {
    return rules_.ledger.has_edge_per_bracket && !rules_.ledger.latency;
  }

  void confirm_by_edge() {
    if (is_confirmed_by_edge() && is_running(state().phase)) confirm(ledger().proved_show_id());
  }

  void discard_unconfirmed() {
    for (const KeepFrame& frame : std::exchange(state().unconfirmed, {})) {
      ledger().empty(frame.slot);
      step_.actions.push_back(DropFrame{frame.ticket});
    }
  }

  void look_at_deadlines() {
    if (is_running(state().phase)) react(ledger().expire(now_));
    const std::optional<Finding> overdue = std::visit(
        Overloaded{[this](const Darkening& darkening) {
                     return overdue_by(darkening.deadline, Incident::kPictureNotShown, "black");
                   },
                   [this](const Confirming& confirming) {
                     return overdue_by(confirming.deadline, Incident::kPictureNotShown,
                                       "black after the last pattern");
                   },
                   [this](const Arming& arming) {
                     return overdue_by(arming.deadline, Incident::kDeviceLost,
                                       "arming did not end in time");
                   },
                   [](const auto&) { return std::optional<Finding>(); }},
        state().phase);
    if (overdue) react({*overdue});
    if (std::holds_alternative<Reopening>(state().phase)) look_at_reopening();
    if (const auto* blackening = std::get_if<Blackening>(&state().phase))
      if (now_ >= blackening->deadline) state().phase = Ended{};
  }

  void look_at_reopening() {
    auto& reopening = std::get<Reopening>(state().phase);
    if (now_ >= reopening.give_up) return give_up(reopening);
    if (reopening.is_trying || now_ < reopening.next_try) return;
    reopening.is_trying = true;
    step_.actions.push_back(Reopen{reopening.lost.front()});
  }

  std::optional<Finding> overdue_by(rig::HostTime deadline, Incident incident, std::string detail) {
    if (now_ < deadline) return std::nullopt;
    return Finding{incident, ledger().showing_pattern(), kNoBracket, std::move(detail)};
  }

  // Reacting, by the table of reaction.h.
  void react(const Findings& findings) {
    for (const Finding& found : findings) {
      if (is_over(state().phase)) return;
      const Reaction reaction = reaction_here(found);
      const Finding finding = charged(found);
      ledger().note(finding);
      step_.reacted.push_back({finding, reaction});
      switch (reaction) {
        case Reaction::kIgnore:
          break;
        case Reaction::kRetake:
          if (!count_retake(finding)) return;
          retake(finding);
          break;
        case Reaction::kRestart:
          if (count_retake(finding)) restart();
          return;                // the other findings were of the run that has just ended
        case Reaction::kReopen:  // no device is named: arming did not end
        case Reaction::kFail:
          fail(finding, std::nullopt, finding.detail);
          break;
      }
    }
  }

  // What confirms a pattern and fails is held against that pattern.
  Finding charged(Finding finding) {
    const bool is_confirming = std::holds_alternative<Confirming>(state().phase);
    if (!is_confirming || finding.pattern != kPrimePattern || state().unconfirmed.empty())
      return finding;
    finding.pattern = state().unconfirmed.back().slot.pattern;
    finding.bracket = kNoBracket;
    return finding;
  }

  // The table, but for two things: a showing that is to be retaken anyhow is not retaken twice, and
  // a priming that fails twice in a run means that camera and box do not count alike.
  Reaction reaction_here(const Finding& finding) {
    const Reaction reaction = reaction_to(finding.incident, rules_.bracketing);
    if (reaction != Reaction::kRetake) return reaction;
    if (finding.pattern == kPrimePattern) {
      if (ledger().is_spoiled(finding.show_id)) return Reaction::kIgnore;
      if (ledger().is_primed()) return Reaction::kRestart;  // it was to confirm the last pattern
      return state().is_priming_retaken ? Reaction::kRestart : Reaction::kRetake;
    }
    const bool is_retaken =
        is_queued(finding.pattern) || ledger().is_shown_again(finding.pattern, finding.show_id);
    return is_retaken ? Reaction::kIgnore : Reaction::kRetake;
  }

  bool is_queued(int pattern) {
    return std::find(state().queue.begin(), state().queue.end(), pattern) != state().queue.end();
  }

  void retake(const Finding& finding) {
    if (finding.bracket == kNoBracket || finding.pattern == kPrimePattern)
      ledger().spoil_showing(finding.show_id);  // none of its frames can count
    if (finding.pattern == kPrimePattern)
      state().is_priming_retaken = true;  // proceed() primes until it has succeeded
    else
      state().queue.push_front(finding.pattern);
  }

  // False, and the capture fails, when the pattern has been retaken often enough.
  bool count_retake(const Finding& finding) {
    const int slot = finding.pattern + 1;
    int& count = state().retake_counts[static_cast<std::size_t>(slot)];
    if (count < rules_.retake_limit) {
      ++count;
      ++state().retake_total;
      return true;
    }
    // Frames that fail to come again and again: a cable that was pulled too short a time ago for
    // the driver to know.
    const bool is_frame =
        finding.incident == Incident::kFrameMissing || finding.incident == Incident::kFrameDamaged;
    if (is_frame && may_reopen()) {
      count = 0;
      reopen(finding, rig::Device::kCamera);
      return false;
    }
    std::string text = name_of_pattern(finding.pattern);
    if (finding.bracket != kNoBracket) text += " bracket " + std::to_string(finding.bracket);
    text += ": " + std::string(to_string(finding.incident)) + " after " + std::to_string(count) +
            (count == 1 ? " retake (" : " retakes (") + finding.detail + "); " +
            std::string(remedy(finding.incident));
    fail(finding, std::nullopt, text);
    return false;
  }

  void restart() {
    ++state().restart_count;
    discard_unconfirmed();
    step_.actions.push_back(Disarm{});
    darken();
  }

  void fail(const Finding& finding, std::optional<rig::Device> device, std::string text) {
    if (is_over(state().phase)) return;
    Failure failure{finding.incident, device, {}, std::move(text)};
    for (const Slot& slot : ledger().slots())
      if (!slot.evidence && slot.last_incident) failure.slots.push_back(slot.id);
    state().failure = std::move(failure);
    end(Outcome::kFailed);
  }

  // Going on.
  void proceed() {
    if (const auto* settling = std::get_if<Settling>(&state().phase)) {
      if (now_ >= settling->deadline) arm();
    } else if (std::holds_alternative<Showing>(state().phase)) {
      wait_for_the_showing();
    } else if (const auto* delaying = std::get_if<Delaying>(&state().phase)) {
      if (now_ >= delaying->fire_at) fire();
    } else if (const auto* pacing = std::get_if<Pacing>(&state().phase)) {
      if (now_ >= pacing->next_show) show_next();
    } else if (std::holds_alternative<Exposing>(state().phase)) {
      if (ledger().is_showing_over()) show_next();
    } else if (std::holds_alternative<Collecting>(state().phase)) {
      show_next();
    } else if (std::holds_alternative<Confirming>(state().phase)) {
      if (state().unconfirmed.empty()) end(Outcome::kComplete);
    }
  }

  void wait_for_the_showing() {
    const auto swapped = ledger().swapped();
    if (rules_.ledger.latency) {
      if (swapped) state().phase = Delaying{*swapped + *rules_.ledger.latency};
    } else if (is_paced()) {
      if (swapped) state().phase = Pacing{*swapped + pace()};
    } else {
      if (ledger().has_edge()) state().phase = Exposing{};
      if (ledger().is_showing_over()) show_next();
    }
  }

  bool is_paced() { return !rules_.refreshes_per_showing.empty() && ledger().is_primed(); }

  // From a swap until the next picture is asked for: in the refresh before it is to be swapped in.
  std::chrono::nanoseconds pace() {
    const int showing = ledger().showing_bracket() / rules_.ledger.brackets_per_showing();
    const int refreshes = rules_.refreshes_per_showing[static_cast<std::size_t>(showing)];
    return rules_.ledger.refresh_interval * (4 * refreshes - 3) / 4;
  }

  void fire() {
    step_.actions.push_back(Fire{});
    state().phase = Exposing{};
  }

  // Where a flip is told from the one before it by its time: as far apart as pace paced has them.
  bool is_too_early() {
    if (!rules_.ledger.relies_on_swaps || rules_.ledger.latency || is_paced() ||
        !ledger().is_showing_over())
      return false;
    const auto swapped = ledger().swapped();
    if (!swapped) return true;  // else overdue, when its frame is
    const rig::HostTime next_show = *swapped + rules_.ledger.refresh_interval * 9 / 4;
    if (now_ >= next_show) return false;
    state().phase = Pacing{next_show};
    return true;
  }

  void show_next() {
    if (is_too_early()) return;
    state().phase = Collecting{};
    if (ledger().is_primed()) state().retake_counts.front() = 0;
    while (!state().queue.empty() && ledger().is_filled(state().queue.front()))
      state().queue.pop_front();  // its frame came after all, of an earlier showing
    const int open_count = ledger().open_showing_count();
    if (const int bracket = ledger().next_bracket(); bracket != kNoBracket) {
      show(ledger().showing_pattern(), bracket);
    } else if (!ledger().is_primed()) {
      if (open_count == 0) show(kPrimePattern, 0);
    } else if (ledger().is_complete()) {
      if (state().unconfirmed.empty()) return end(Outcome::kComplete);
      confirm_last();
    } else if (!state().queue.empty()) {
      if (open_count < (is_paced() ? kPacedShowingLimit : kOpenShowingLimit)) {
        const int pattern = state().queue.front();
        state().queue.pop_front();
        show(pattern, 0);
      }
    } else {
      estimation::check(open_count > 0, "open slots, but nothing is awaited");
    }
  }

  void confirm_last() {
    const rig::HostTime deadline = now_ + rules_.ledger.edge_deadline;
    if (!is_confirmed_by_edge()) {
      state().phase = Confirming{ask_for(rig::kBlackPicture), deadline};
      return;
    }
    show(kPrimePattern, 0);
    state().phase = Confirming{};  // until the edge, whose deadline is the ledger's
  }

  void darken() {
    state().is_square_light = false;
    state().phase = Darkening{ask_for(rig::kBlackPicture), now_ + rules_.ledger.edge_deadline};
    state().queue.clear();
    for (const int pattern : order_)
      if (!ledger().is_filled(pattern)) state().queue.push_back(pattern);
  }

  void arm() {
    const int bracket_count = static_cast<int>(rules_.ledger.exposures.size());
    // The patterns, the priming, what confirms the last, and as many retakes as one may have.
    const int confirming_count = is_confirmed_by_edge() ? 1 : 0;
    const int showing_count = static_cast<int>(state().queue.size()) +
                              rules_.ledger.priming_rounds + confirming_count + rules_.retake_limit;
    ++state().run_id;
    state().phase = Arming{now_ + kArmDeadline};
    step_.actions.push_back(Arm{state().run_id, showing_count * bracket_count});
  }

  void show(int pattern, int first_bracket) {
    state().is_square_light = !state().is_square_light;
    const std::uint64_t show_id = ask_for(pattern == kPrimePattern ? rig::kBlackPicture : pattern);
    ledger().open_showing({pattern, first_bracket, show_id, state().is_square_light, now_});
    state().phase = Showing{};
  }

  void end(Outcome outcome) {
    discard_unconfirmed();
    state().is_square_light = false;
    state().outcome = outcome;
    state().phase = Blackening{ask_for(rig::kBlackPicture), now_ + kBlackDeadline};
    step_.actions.push_back(Disarm{});
  }

  std::uint64_t ask_for(int picture) {
    const std::uint64_t show_id = state().next_show_id++;
    step_.actions.push_back(Show{{show_id, picture, state().is_square_light}});
    return show_id;
  }

  const SequenceRules& rules_;
  const std::vector<int>& order_;
  const rig::HostTime now_;
  Step step_;
};

}  // namespace

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
