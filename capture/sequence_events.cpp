#include <algorithm>
#include <utility>

#include "capture/sequence_turn.h"

namespace capture {
namespace {

constexpr std::chrono::milliseconds kReopenPeriod{500};

}  // namespace

Step Turn::run(const SequenceEvent& event) && {
  std::visit([this](const auto& e) { take(e); }, event);
  judge_frames();
  look_at_deadlines();
  proceed();
  return std::move(step_);
}

void Turn::take(const Start&) {
  if (std::holds_alternative<Idle>(state().phase)) darken();
}

void Turn::take(const AbortRequested&) {
  if (!is_over(state().phase)) end(Outcome::kAborted);
}

// Before the first run nothing of this capture was flipped; of another's last flip the level tells.
rig::HostTime Turn::settled_at() {
  const rig::HostTime settled = now_ + rules_.settle_time;
  if (state().run_id == 0 && !rules_.ledger.relies_on_swaps) return settled;
  return std::max<rig::HostTime>(settled,
                                 state().darkened.value_or(now_) + rules_.ledger.edge_deadline);
}

void Turn::take(const Armed&) {
  if (!std::holds_alternative<Arming>(state().phase)) return;
  ledger().start_run();
  state().is_priming_retaken = false;
  state().has_listened = false;
  state().phase = Collecting{};  // nothing is awaited yet: proceed() shows the priming
}

void Turn::take(const CommandRefused& refused) { take_device_error(refused.device, refused.error); }

void Turn::take(const rig::DeviceFault& fault) {
  // Between runs only a lost device matters: the rest is of a run that is given up.
  if (is_running(state().phase) || incident_of(fault.error.fault) == Incident::kDeviceLost ||
      incident_of(fault.error.fault) == Incident::kDeviceRefused)
    take_device_error(fault.device, fault.error);
}

void Turn::take(const StorageFailed& failed) {
  react({{Incident::kStorage, ledger().showing_pattern(), kNoBracket, failed.text}});
}

void Turn::take(const rig::PictureShown& shown) {
  if (shown.show_id == state().dark_show_id && !state().darkened) state().darkened = now_;
  if (const auto* darkening = std::get_if<Darkening>(&state().phase)) {
    if (darkening->show_id == shown.show_id) state().phase = Settling{settled_at()};
  } else if (const auto* blackening = std::get_if<Blackening>(&state().phase)) {
    if (blackening->show_id == shown.show_id) state().phase = Ended{};
  } else if (is_running(state().phase)) {
    auto* const confirming = std::get_if<Confirming>(&state().phase);
    if (confirming != nullptr && confirming->show_id == shown.show_id)
      confirming->deadline = rig::HostTime::max();
    if (!is_confirmed_by_edge()) confirm(shown.show_id);
    react(ledger().picture_shown(shown));
    confirm_by_edge();
  }
}

void Turn::take(const rig::EdgeSeen& edge) {
  if (!is_running(state().phase)) return;
  react(ledger().edge_seen(edge, now_));
  confirm_by_edge();
}

void Turn::take(const rig::EdgeIgnored& edge) {
  if (is_running(state().phase)) react(ledger().edge_ignored(edge));
}

void Turn::take(const rig::PulseEnded& pulse) {
  if (is_running(state().phase)) react(ledger().pulse_ended(pulse, now_));
}

void Turn::take(const FrameSeen& frame) {
  if (is_running(state().phase))
    ledger().frame_seen(frame.facts, now_);
  else
    step_.actions.push_back(DropFrame{frame.facts.ticket});
}

void Turn::take(const rig::FrameDamaged& damaged) {
  if (is_running(state().phase)) react(ledger().frame_damaged(damaged));
}

void Turn::take_device_error(rig::Device device, const rig::Error& error) {
  if (is_over(state().phase)) return;
  const Finding finding{incident_of(error.fault), ledger().showing_pattern(), kNoBracket,
                        error.detail};
  const Reaction reaction = reaction_to(finding.incident, rules_.bracketing);
  if (reaction != Reaction::kFail && reaction != Reaction::kReopen) return react({finding});
  // A window whose X server is gone cannot be made again in this process.
  const bool is_final = device == rig::Device::kProjector && error.fault == rig::Fault::kDeviceLost;
  if (reaction == Reaction::kReopen && !is_final && may_reopen()) return reopen(finding, device);
  step_.reacted.push_back({finding, Reaction::kFail});
  fail(finding, device, std::string(to_string(device)) + ": " + error.detail);
}

// A window's X server aside, any device that was lost, a bounded number of times.
bool Turn::may_reopen() {
  return rules_.reopen_deadline.count() > 0 && (std::holds_alternative<Reopening>(state().phase) ||
                                                state().reopen_count < rules_.reopen_limit);
}

void Turn::reopen(const Finding& finding, rig::Device device) {
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

void Turn::take(const Reopened& reopened) {
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

void Turn::take(const ReopenRefused& refused) {
  auto* reopening = std::get_if<Reopening>(&state().phase);
  if (reopening == nullptr) return;
  reopening->is_trying = false;
  reopening->next_try = now_ + kReopenPeriod;
  reopening->cause = refused.error.detail;
}

void Turn::give_up(const Reopening& reopening) {
  const rig::Device device = reopening.lost.front();
  const Finding finding{Incident::kDeviceLost, ledger().showing_pattern(), kNoBracket,
                        reopening.cause};
  step_.reacted.push_back({finding, Reaction::kFail});
  fail(finding, device,
       std::string(to_string(device)) + ": lost, and not back within " +
           std::to_string(rules_.reopen_deadline.count() / 1000) + " s: " + finding.detail);
}

void Turn::judge_frames() {
  if (!is_running(state().phase)) return;
  Findings findings;
  for (const Verdict& verdict : ledger().judge(findings)) {
    if (verdict.slot)
      keep({verdict.ticket, *verdict.slot, verdict.evidence});
    else
      step_.actions.push_back(DropFrame{verdict.ticket});
  }
  confirm_anew();
  react(findings);
}

void Turn::keep(const KeepFrame& frame) {
  if (is_confirmed(frame))
    step_.actions.push_back(frame);
  else
    state().unconfirmed.push_back(frame);
}

bool Turn::is_confirmed(const KeepFrame& frame) {
  return frame.evidence.show_id < state().shown_show_id && is_counted(frame);
}

// A stray exposure that takes a pulse's place just before it, as long after the pulse as the
// clocks are good, shows in the numbers of all frames after it. After the last there is none.
bool Turn::is_counted(const KeepFrame& frame) {
  if (rules_.ledger.has_edge_per_bracket)
    return ledger().is_count_proved(frame.evidence.pulse_number);
  if (frame.evidence.pulse_number < ledger().proved_pulse_number()) return true;
  return std::holds_alternative<Confirming>(state().phase) && ledger().open_showing_count() == 0;
}

void Turn::confirm_anew() {
  for (const KeepFrame& frame : std::exchange(state().unconfirmed, {})) keep(frame);
}

// The display was as opened when picture `show_id` was drawn, so those before it were what we
// meant.
void Turn::confirm(std::uint64_t show_id) {
  state().shown_show_id = std::max(state().shown_show_id, show_id);
  confirm_anew();
}

// Where a stray trigger could be taken for a flip.
bool Turn::is_confirmed_by_edge() const {
  return rules_.ledger.has_edge_per_bracket && !rules_.ledger.latency;
}

void Turn::confirm_by_edge() {
  if (is_confirmed_by_edge() && is_running(state().phase)) confirm(ledger().proved_show_id());
}

void Turn::discard_unconfirmed() {
  for (const KeepFrame& frame : std::exchange(state().unconfirmed, {})) {
    ledger().empty(frame.slot);
    step_.actions.push_back(DropFrame{frame.ticket});
  }
}

}  // namespace capture
