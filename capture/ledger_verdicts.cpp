// Whose a frame is, and what is overdue.
#include <algorithm>
#include <utility>

#include "capture/ledger.h"

namespace capture {
namespace {

using std::chrono::microseconds;
using std::chrono::nanoseconds;

// The pulse's start is known to the trigger box's clock map, the frame's to the camera's: both good
// to some ten microseconds on an idle host.
constexpr nanoseconds kPulseTimeUncertainty{100'000};

// Cameras round exposures to line times (10 to 30 us); brackets differ by far more than 2%.
bool is_same_exposure(microseconds a, microseconds b) {
  return std::chrono::abs(a - b) <= microseconds(30) + b / 50;
}

}  // namespace

void Ledger::frame_seen(const FrameFacts& facts, rig::HostTime now) {
  held_.push_back({facts, now + rules_.frame_deadline});
  const std::uint64_t number = facts.pulse_number();
  if (number == 0 || number > pulses_.size() || pulses_[number - 1].wait != Wait::kAwaited) return;
  // Those after it may have waited for it in a slow link.
  for (std::size_t later = number; later < pulses_.size(); ++later)
    pulses_[later].frame_due = std::max(pulses_[later].frame_due, now + rules_.frame_deadline);
}

bool Ledger::is_decidable(const FrameFacts& facts) const {
  const std::uint64_t number = facts.pulse_number();
  if (number == 0 || facts.block_id > number) return true;  // impossible numbers
  if (number > pulses_.size()) return false;  // the box may tell later than the camera
  const Showing& showing = showings_[pulses_[number - 1].showing];
  return showing.is_spoiled || (is_over(showing) && showing.swapped);
}

std::vector<Verdict> Ledger::judge(Findings& findings) {
  std::vector<Verdict> verdicts;
  std::vector<Held> still_held;
  for (const Held& held : held_) {
    if (is_decidable(held.facts))
      verdicts.push_back(decide(held.facts, findings));
    else
      still_held.push_back(held);
  }
  held_ = std::move(still_held);
  return verdicts;
}

// Does the frame say something else than the pulse whose number it bears?
std::optional<Finding> Ledger::contradiction(const FrameFacts& facts, const Pulse& pulse) const {
  const Flip& flip = showings_[pulse.showing].flip;
  const auto contradicted = [&](Incident incident, std::string detail) {
    return Finding{incident, flip.pattern, pulse.bracket, std::move(detail), flip.show_id};
  };
  // A pulse is as long as its exposure. Without chunks this is what a stray pulse on the line shows
  // in, when its frame bears the number of the next pulse.
  if (facts.received < pulse.ended - rules_.time_tolerance())
    return contradicted(Incident::kFrameMistimed, "the frame was there before its pulse had ended");
  if (camera_clock_.is_ready()) {
    const nanoseconds error = camera_clock_.to_host(facts.timestamp) - pulse.started;
    if (std::chrono::abs(error) >= rules_.time_tolerance())
      return contradicted(Incident::kFrameMistimed,
                          "its timestamp is " + in_us(error) + " from its pulse");
  }
  const microseconds expected = rules_.exposures[static_cast<std::size_t>(pulse.bracket)];
  if (facts.exposure && !is_same_exposure(*facts.exposure, expected))
    return contradicted(Incident::kFrameMisexposed,
                        "exposed for " + in_us(*facts.exposure) + " instead of " + in_us(expected));
  return std::nullopt;
}

void Ledger::note_promptness(const FrameFacts& facts, const Pulse& pulse) {
  // Less than two flips are apart.
  const nanoseconds two_exposures =
      rules_.exposures.front() + rules_.exposures[rules_.exposures.size() > 1 ? 1 : 0];
  const nanoseconds tolerance = std::max(rules_.refresh_interval, two_exposures / 2 + rules_.gap);
  const nanoseconds delay = facts.received - pulse.ended;
  least_delay_ = std::min(least_delay_.value_or(delay), delay);
  if (delay <= *least_delay_ + tolerance)
    prompt_pulse_number_ =
        std::max(prompt_pulse_number_, static_cast<std::uint32_t>(facts.pulse_number()));
}

Verdict Ledger::decide(const FrameFacts& facts, Findings& findings) {
  Verdict verdict{facts.ticket, std::nullopt, {}};
  const std::uint64_t number = facts.pulse_number();
  if (number == 0 || facts.block_id > number) {
    findings.push_back(about_last_showing(
        Incident::kFrameUnexpected,
        "block " + std::to_string(facts.block_id) + " claims pulse " + std::to_string(number)));
    return verdict;
  }
  Pulse& pulse = pulses_[number - 1];
  const Showing& showing = showings_[pulse.showing];
  if (showing.is_spoiled) {
    pulse.wait = Wait::kArrived;
    return verdict;
  }
  if (const auto finding = contradiction(facts, pulse)) {
    if (pulse.wait == Wait::kAwaited) pulse.wait = Wait::kGivenUp;
    findings.push_back(*finding);
    return verdict;
  }
  if (pulse.wait != Wait::kAwaited) {
    findings.push_back(
        {pulse.wait == Wait::kArrived ? Incident::kFrameDuplicate : Incident::kFrameLate,
         showing.flip.pattern, pulse.bracket, "block " + std::to_string(facts.block_id),
         showing.flip.show_id});
    return verdict;
  }
  pulse.wait = Wait::kArrived;
  proved_pulse_number_ = std::max(proved_pulse_number_, static_cast<std::uint32_t>(number));
  camera_clock_.add(facts.timestamp, pulse.started, kPulseTimeUncertainty);
  note_promptness(facts, pulse);
  if (showing.flip.pattern == kPrimePattern) {
    const int wanted_count = rules_.priming_rounds * static_cast<int>(rules_.exposures.size());
    if (++primed_frame_count_ >= wanted_count) is_primed_ = true;
    return verdict;
  }
  Slot& target = slot({showing.flip.pattern, pulse.bracket});
  if (target.evidence) return verdict;  // the retake was for another bracket of this pattern
  target.evidence = evidence_of(facts, pulse);
  ++filled_count_;
  verdict.slot = target.id;
  verdict.evidence = *target.evidence;
  return verdict;
}

Evidence Ledger::evidence_of(const FrameFacts& facts, const Pulse& pulse) const {
  const Showing& showing = showings_[pulse.showing];
  Evidence evidence;
  evidence.show_id = showing.flip.show_id;
  evidence.swapped = *showing.swapped;
  evidence.edge_number = showing.edge->edge_number;
  evidence.is_light = showing.edge->is_light;
  evidence.edge = showing.edge->time;
  evidence.pulse_number = static_cast<std::uint32_t>(facts.pulse_number());
  evidence.pulse_started = pulse.started;
  evidence.pulse_ended = pulse.ended;
  evidence.block_id = facts.block_id;
  evidence.camera_timestamp = facts.timestamp;
  evidence.exposure = facts.exposure;
  return evidence;
}

Findings Ledger::expire(rig::HostTime now) {
  Findings findings;
  for (const Showing& showing : showings_) {
    if (is_settled(showing) || now < showing.due) continue;
    if (is_over(showing))
      findings.push_back(about(showing, Incident::kPictureNotShown, "the swap was never reported"));
    else if (showing.edge)
      findings.push_back(
          about(showing, Incident::kPulseMissing, "the trigger box did not end its pulses"));
    else if (showing.swapped)
      findings.push_back(about(showing, Incident::kEdgeMissing, "the picture was shown"));
    else
      findings.push_back(
          about(showing, Incident::kPictureNotShown, "neither swap nor edge was reported"));
  }
  for (Pulse& pulse : pulses_) {
    if (pulse.wait != Wait::kAwaited || now < pulse.frame_due) continue;
    const Showing& showing = showings_[pulse.showing];
    if (!is_settled(showing) && !showing.is_spoiled) continue;  // its own deadline rules
    pulse.wait = Wait::kGivenUp;
    if (showing.is_spoiled) continue;
    findings.push_back(
        {Incident::kFrameMissing, showing.flip.pattern, pulse.bracket,
         "none within " + std::to_string(rules_.frame_deadline.count()) + " ms of its pulse",
         showing.flip.show_id});
  }
  for (const Held& held : held_) {
    if (now < held.due || held.facts.pulse_number() <= pulses_.size()) continue;
    findings.push_back(about_last_showing(
        Incident::kFrameUnexpected,
        "the trigger box never told of pulse " + std::to_string(held.facts.pulse_number())));
  }
  return findings;
}

std::optional<rig::HostTime> Ledger::next_due() const {
  std::optional<rig::HostTime> due;
  const auto consider = [&due](rig::HostTime time) {
    if (!due || time < *due) due = time;
  };
  for (const Showing& showing : showings_)
    if (!is_settled(showing)) consider(showing.due);
  for (const Pulse& pulse : pulses_) {
    const Showing& showing = showings_[pulse.showing];
    if (pulse.wait == Wait::kAwaited && (is_settled(showing) || showing.is_spoiled))
      consider(pulse.frame_due);
  }
  for (const Held& held : held_)
    if (held.facts.pulse_number() > pulses_.size()) consider(held.due);
  return due;
}

}  // namespace capture
