#include <algorithm>
#include <utility>

#include "capture/sequence_turn.h"

namespace capture {
namespace {

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

}  // namespace

void Turn::look_at_deadlines() {
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

void Turn::look_at_reopening() {
  auto& reopening = std::get<Reopening>(state().phase);
  if (now_ >= reopening.give_up) return give_up(reopening);
  if (reopening.is_trying || now_ < reopening.next_try) return;
  reopening.is_trying = true;
  step_.actions.push_back(Reopen{reopening.lost.front()});
}

std::optional<Finding> Turn::overdue_by(rig::HostTime deadline, Incident incident,
                                        std::string detail) {
  if (now_ < deadline) return std::nullopt;
  return Finding{incident, ledger().showing_pattern(), kNoBracket, std::move(detail)};
}

void Turn::react(const Findings& findings) {
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
Finding Turn::charged(Finding finding) {
  const bool is_confirming = std::holds_alternative<Confirming>(state().phase);
  if (!is_confirming || finding.pattern != kPrimePattern || state().unconfirmed.empty())
    return finding;
  finding.pattern = state().unconfirmed.back().slot.pattern;
  finding.bracket = kNoBracket;
  return finding;
}

// The table, but for four things: what nobody needs is not retaken; a showing that is to be retaken
// anyhow is not retaken twice; a priming that fails twice in a run means that camera and box do not
// count alike; and where times are all that tells flips from each other, one without a time leaves
// those after it untold.
Reaction Turn::reaction_here(const Finding& finding) {
  const Reaction reaction = reaction_to(finding.incident, rules_.bracketing);
  if (reaction != Reaction::kRetake) return reaction;
  if (rules_.ledger.relies_on_swaps && !rules_.ledger.latency) return Reaction::kRestart;
  if (finding.pattern == kPrimePattern) {
    if (ledger().is_spoiled(finding.show_id)) return Reaction::kIgnore;
    if (ledger().is_primed()) return Reaction::kRestart;  // it was to confirm the last pattern
    return state().is_priming_retaken ? Reaction::kRestart : Reaction::kRetake;
  }
  if (ledger().is_filled(SlotId{finding.pattern, finding.bracket})) return Reaction::kIgnore;
  const bool is_retaken =
      is_queued(finding.pattern) || ledger().is_shown_again(finding.pattern, finding.show_id);
  return is_retaken ? Reaction::kIgnore : Reaction::kRetake;
}

bool Turn::is_queued(int pattern) {
  return std::find(state().queue.begin(), state().queue.end(), pattern) != state().queue.end();
}

void Turn::retake(const Finding& finding) {
  if (finding.bracket == kNoBracket || finding.pattern == kPrimePattern)
    ledger().spoil_showing(finding.show_id);  // none of its frames can count
  if (finding.pattern == kPrimePattern)
    state().is_priming_retaken = true;  // proceed() primes until it has succeeded
  else
    state().queue.push_front(finding.pattern);
}

// False, and the capture fails, when the pattern has been retaken often enough.
bool Turn::count_retake(const Finding& finding) {
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

void Turn::restart() {
  ++state().restart_count;
  discard_unconfirmed();
  step_.actions.push_back(Disarm{});
  darken();
}

void Turn::fail(const Finding& finding, std::optional<rig::Device> device, std::string text) {
  if (is_over(state().phase)) return;
  discard_unconfirmed();
  ledger().note(finding);
  Failure failure{finding.incident, device, {}, std::move(text)};
  for (const Slot& slot : ledger().slots())
    if (!slot.evidence && slot.last_incident) failure.slots.push_back(slot.id);
  state().failure = std::move(failure);
  end(Outcome::kFailed);
}

}  // namespace capture
