#include "capture/ledger.h"

#include <algorithm>
#include <utility>

#include "estimation/base/check.h"

namespace capture {
namespace {

using estimation::check;
using std::chrono::duration_cast;
using std::chrono::microseconds;
using std::chrono::nanoseconds;

// The pulse's start is known to the trigger box's clock map, the frame's to the camera's: both good
// to some ten microseconds on an idle host.
constexpr nanoseconds kPulseTimeUncertainty{100'000};
// The camera's clock is read when it is armed, and drifts by up to 50 ppm from then on: 40 s.
constexpr nanoseconds kCameraTimeUncertainty{2'000'000};

// From asking for a picture to the report of its swap: up to a refresh to the vertical blank, and
// as much again.
constexpr int kPunctualRefreshes = 2;

std::string in_us(nanoseconds time) {
  return std::to_string(duration_cast<microseconds>(time).count()) + " us";
}

// Cameras round exposures to line times (10 to 30 us); brackets differ by far more than 2%.
bool is_same_exposure(microseconds a, microseconds b) {
  return std::chrono::abs(a - b) <= microseconds(30) + b / 50;
}

}  // namespace

Ledger::Ledger(LedgerRules rules, int pattern_count)
    : rules_(std::move(rules)), lag_(rules_.refresh_interval) {
  check(!rules_.exposures.empty(), "a ledger needs at least one exposure");
  for (int pattern = 0; pattern < pattern_count; ++pattern)
    for (int bracket = 0; bracket < static_cast<int>(rules_.exposures.size()); ++bracket)
      slots_.push_back({{pattern, bracket}, {}, {}});
}

void Ledger::start_run() {
  showings_.clear();
  pulses_.clear();
  held_.clear();
  camera_clock_ = {};
  last_edge_number_ = 0;
  lag_.forget();
  primed_frame_count_ = 0;
  is_priming_spoiled_ = false;
  is_primed_ = false;
}

void Ledger::open_showing(const Flip& flip) {
  if (flip.pattern == kPrimePattern && flip.first_bracket == 0 && is_priming_spoiled_) {
    // It may have taught a wrong offset; the next one starts afresh.
    camera_clock_ = {};
    lag_.forget();
    primed_frame_count_ = 0;
    is_priming_spoiled_ = false;
  }
  Showing showing;
  showing.flip = flip;
  showing.due = flip.requested + rules_.edge_deadline;
  // The edge is heard of when its frame comes.
  if (rules_.has_edge_per_bracket) showing.due += rules_.frame_deadline + train_length(showing);
  showings_.push_back(showing);
}

nanoseconds Ledger::train_length(const Showing& showing) const {
  nanoseconds length{0};
  const int end = showing.flip.first_bracket + rules_.brackets_per_showing();
  for (int bracket = showing.flip.first_bracket; bracket < end; ++bracket)
    length += rules_.exposures[static_cast<std::size_t>(bracket)] + rules_.gap;
  return length;
}

Finding Ledger::about(const Showing& showing, Incident incident, std::string detail) const {
  const int bracket = rules_.has_edge_per_bracket ? showing.flip.first_bracket : kNoBracket;
  return {incident, showing.flip.pattern, bracket, std::move(detail), showing.flip.show_id};
}

Finding Ledger::about_last_showing(Incident incident, std::string detail) const {
  if (showings_.empty()) return {incident, kPrimePattern, kNoBracket, std::move(detail)};
  return about(showings_.back(), incident, std::move(detail));
}

// The showing whose edge comes next; nullptr: none is due.
Ledger::Showing* Ledger::without_edge() {
  for (Showing& showing : showings_)
    if (!showing.edge && !showing.is_edge_lost) return &showing;
  return nullptr;
}

// The one whose edge came last; nullptr: none has come.
Ledger::Showing* Ledger::under_exposure() {
  for (auto showing = showings_.rbegin(); showing != showings_.rend(); ++showing)
    if (showing->edge) return &*showing;
  return nullptr;
}

const Ledger::Showing* Ledger::find(std::uint64_t show_id) const {
  for (const Showing& showing : showings_)
    if (showing.flip.show_id == show_id) return &showing;
  return nullptr;
}

Findings Ledger::picture_shown(const rig::PictureShown& shown) {
  for (Showing& showing : showings_) {
    if (showing.flip.show_id != shown.show_id) continue;
    showing.swapped = shown.swapped;
    if (Findings late = check_swap(showing); !late.empty()) return late;
    return check_flip(showing);
  }
  return {};
}

// A display that keeps time swaps at the next vertical blank, and tells of it in the refresh after.
Findings Ledger::check_swap(const Showing& showing) const {
  const nanoseconds taken = *showing.swapped - showing.flip.requested;
  if (!rules_.relies_on_swaps || showing.is_spoiled ||
      taken <= rules_.refresh_interval * kPunctualRefreshes)
    return {};
  return {about(showing, Incident::kPictureLate,
                "the picture was swapped in " + in_us(taken) + " after it was asked for")};
}

Findings Ledger::edge_seen(const rig::EdgeSeen& edge) {
  Showing* const showing = without_edge();
  if (showing == nullptr)
    return {about_last_showing(Incident::kEdgeOutOfOrder,
                               "edge " + std::to_string(edge.edge_number) + " when none was due")};
  if (edge.edge_number != last_edge_number_ + 1)
    return {about(*showing, Incident::kEdgeOutOfOrder,
                  "edge " + std::to_string(edge.edge_number) + " after edge " +
                      std::to_string(last_edge_number_))};
  last_edge_number_ = edge.edge_number;
  if (edge.is_light != showing->flip.is_light)
    return {about(*showing, Incident::kEdgeWrongLevel,
                  std::string("the photodiode turned ") + (edge.is_light ? "light" : "dark") +
                      " under a " + (showing->flip.is_light ? "light" : "dark") + " square")};
  showing->edge = edge;
  showing->due = edge.time + train_length(*showing) + rules_.edge_deadline;
  return check_flip(*showing);
}

// Both are known: was it our flip that the photodiode saw?
Findings Ledger::check_flip(const Showing& showing) {
  if (showing.is_spoiled || !showing.swapped || !showing.edge) return {};
  if (rules_.latency) return check_latency(showing);
  // A swap is reported up to a refresh after the vertical blank at which it happened.
  if (showing.edge->time < *showing.swapped - rules_.refresh_interval)
    return {about(showing, Incident::kEdgeBeforeFlip,
                  "the edge came " + in_us(*showing.swapped - showing.edge->time) +
                      " before the picture was swapped in")};
  return rules_.is_lag_checked ? check_lag(showing) : Findings{};
}

// Another light must be told from our flip by its time; so must a flip from the one before it,
// where pictures follow each other without waiting.
Findings Ledger::check_lag(const Showing& showing) {
  const rig::HostTime edge = showing.edge->time;
  const nanoseconds early = showing.flip.requested - edge;
  if (early > kCameraTimeUncertainty)
    return {about(showing, Incident::kEdgeBeforeFlip,
                  "the edge came " + in_us(early) + " before the picture was asked for")};
  const nanoseconds lag = edge - *showing.swapped;
  const std::optional<nanoseconds> off = is_primed_ ? lag_.check(lag) : lag_.learn(lag);
  if (!off) return {};
  const bool is_early = *off < nanoseconds(0);
  return {about(showing, is_early ? Incident::kEdgeBeforeFlip : Incident::kEdgeLate,
                "the edge came " + in_us(std::chrono::abs(*off)) +
                    (is_early ? " earlier" : " later") + " after the swap than in the priming")};
}

// Our own trigger: not before the light of the picture was there.
Findings Ledger::check_latency(const Showing& showing) const {
  const nanoseconds early = *showing.swapped + *rules_.latency - showing.edge->time;
  if (early <= kCameraTimeUncertainty) return {};
  return {about(showing, Incident::kEdgeBeforeFlip,
                "the exposure began " + in_us(early) + " before the picture's light")};
}

Findings Ledger::edge_ignored(const rig::EdgeIgnored& edge) {
  Showing* const showing = under_exposure();
  if (showing == nullptr) return {};
  if (edge.time - showing->edge->time <= rules_.debounce) {
    showing->is_level_gone = edge.is_light != showing->edge->is_light;
    return {};
  }
  return {about(*showing, Incident::kEdgeDuringExposure,
                "the light changed " + in_us(edge.time - showing->edge->time) + " after the edge")};
}

Findings Ledger::pulse_ended(const rig::PulseEnded& pulse, rig::HostTime now) {
  Showing* const showing = under_exposure();
  const bool is_next = showing != nullptr && !is_over(*showing) &&
                       pulse.pulse_number == pulses_.size() + 1 &&
                       pulse.edge_number == showing->edge->edge_number &&
                       pulse.pulse_index == showing->ended_pulse_count;
  if (!is_next)
    return {about_last_showing(Incident::kPulseOutOfOrder,
                               "pulse " + std::to_string(pulse.pulse_number) + " of edge " +
                                   std::to_string(pulse.edge_number) +
                                   " was not the next one due")};
  pulses_.push_back({static_cast<std::size_t>(showing - showings_.data()),
                     showing->flip.first_bracket + pulse.pulse_index, pulse.started, pulse.ended,
                     now + rules_.frame_deadline, Wait::kAwaited});
  ++showing->ended_pulse_count;
  if (!std::exchange(showing->is_level_gone, false)) return {};
  return {about(*showing, Incident::kEdgeDuringExposure,
                "the light changed back right after the edge, and stayed so")};
}

Findings Ledger::frame_damaged(const rig::FrameDamaged& damaged) {
  // A damaged block has no chunks to prove whose it is. Its id is only a reason to stop waiting: a
  // good frame of that pulse, should one come, is then late and not used.
  if (damaged.block_id == 0) return {};
  if (damaged.block_id > pulses_.size()) return lose_edge(damaged);
  Pulse& pulse = pulses_[damaged.block_id - 1];
  if (pulse.wait != Wait::kAwaited) return {};
  pulse.wait = Wait::kGivenUp;
  const Showing& showing = showings_[pulse.showing];
  if (showing.is_spoiled) return {};
  return {{Incident::kFrameDamaged, showing.flip.pattern, pulse.bracket, damaged.error.detail,
           showing.flip.show_id}};
}

// Where frames alone tell of edges: the camera has exposed, but for whom it does not say. Taken for
// the edge that was due; had it been another one, the next frame's count would show it.
Findings Ledger::lose_edge(const rig::FrameDamaged& damaged) {
  Showing* const showing = without_edge();
  if (!rules_.has_edge_per_bracket || showing == nullptr || damaged.block_id != pulses_.size() + 1)
    return {};
  ++last_edge_number_;
  showing->is_edge_lost = true;
  showing->ended_pulse_count = 1;
  pulses_.push_back({static_cast<std::size_t>(showing - showings_.data()),
                     showing->flip.first_bracket,
                     {},
                     {},
                     {},
                     Wait::kGivenUp});
  return {about(*showing, Incident::kFrameDamaged, damaged.error.detail)};
}

void Ledger::frame_seen(const FrameFacts& facts, rig::HostTime now) {
  held_.push_back({facts, now + rules_.frame_deadline});
}

bool Ledger::is_over(const Showing& showing) const {
  return showing.ended_pulse_count == rules_.brackets_per_showing();
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
  camera_clock_.add(facts.timestamp, pulse.started, kPulseTimeUncertainty);
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
    if (is_over(showing) || now < showing.due) continue;
    if (showing.edge)
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
    Showing& showing = showings_[pulse.showing];
    if (!is_over(showing) && !showing.is_spoiled) continue;  // the pulses' own deadline rules
    pulse.wait = Wait::kGivenUp;
    if (showing.is_spoiled) continue;
    if (!showing.swapped) {
      showing.is_spoiled = true;
      findings.push_back({Incident::kPictureNotShown, showing.flip.pattern, pulse.bracket,
                          "the swap was never reported", showing.flip.show_id});
    } else {
      findings.push_back(
          {Incident::kFrameMissing, showing.flip.pattern, pulse.bracket,
           "none within " + std::to_string(rules_.frame_deadline.count()) + " ms of its pulse",
           showing.flip.show_id});
    }
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
    if (!is_over(showing)) consider(showing.due);
  for (const Pulse& pulse : pulses_) {
    const Showing& showing = showings_[pulse.showing];
    if (pulse.wait == Wait::kAwaited && (is_over(showing) || showing.is_spoiled))
      consider(pulse.frame_due);
  }
  for (const Held& held : held_)
    if (held.facts.pulse_number() > pulses_.size()) consider(held.due);
  return due;
}

int Ledger::showing_pattern() const {
  return showings_.empty() ? kPrimePattern : showings_.back().flip.pattern;
}
int Ledger::showing_bracket() const {
  return showings_.empty() ? 0 : showings_.back().flip.first_bracket;
}
std::optional<rig::HostTime> Ledger::swapped() const {
  return showings_.empty() ? std::nullopt : showings_.back().swapped;
}
bool Ledger::has_edge() const { return !showings_.empty() && showings_.back().edge; }
bool Ledger::is_showing_over() const { return !showings_.empty() && is_over(showings_.back()); }

int Ledger::next_bracket() const {
  if (showings_.empty()) return kNoBracket;
  const int next = showings_.back().flip.first_bracket + rules_.brackets_per_showing();
  return next < static_cast<int>(rules_.exposures.size()) ? next : kNoBracket;
}

std::uint64_t Ledger::proved_show_id() const {
  for (auto showing = showings_.rbegin(); showing != showings_.rend(); ++showing)
    if (showing->edge && showing->swapped) return showing->flip.show_id;
  return 0;
}

void Ledger::spoil_showing(std::uint64_t show_id) {
  for (Showing& showing : showings_) {
    if (showing.flip.show_id != show_id) continue;
    showing.is_spoiled = true;
    is_priming_spoiled_ = is_priming_spoiled_ || showing.flip.pattern == kPrimePattern;
  }
}

bool Ledger::is_spoiled(std::uint64_t show_id) const {
  const Showing* const showing = find(show_id);
  return showing != nullptr && showing->is_spoiled;
}

bool Ledger::is_shown_again(int pattern, std::uint64_t show_id) const {
  return std::any_of(showings_.begin(), showings_.end(), [&](const Showing& showing) {
    const bool is_first = showing.flip.first_bracket == 0;
    return is_first && showing.flip.pattern == pattern && showing.flip.show_id > show_id;
  });
}

int Ledger::open_showing_count() const {
  std::vector<bool> is_open;
  for (const Showing& showing : showings_) is_open.push_back(!is_over(showing));
  for (const Pulse& pulse : pulses_)
    if (pulse.wait == Wait::kAwaited) is_open[pulse.showing] = true;
  return static_cast<int>(std::count(is_open.begin(), is_open.end(), true));
}

Slot& Ledger::slot(SlotId id) {
  const auto index = static_cast<std::size_t>(id.pattern) * rules_.exposures.size() +
                     static_cast<std::size_t>(id.bracket);
  check(index < slots_.size(), "slot outside the plan");
  return slots_[index];
}

bool Ledger::is_filled(int pattern) const {
  return std::all_of(slots_.begin(), slots_.end(), [pattern](const Slot& slot) {
    return slot.id.pattern != pattern || slot.evidence.has_value();
  });
}

void Ledger::empty(SlotId id) {
  Slot& emptied = slot(id);
  if (emptied.evidence) --filled_count_;
  emptied.evidence.reset();
}

void Ledger::note(const Finding& finding) {
  for (Slot& slot : slots_) {
    const bool is_concerned = slot.id.pattern == finding.pattern &&
                              (finding.bracket == kNoBracket || slot.id.bracket == finding.bracket);
    if (is_concerned && !slot.evidence) slot.last_incident = finding.incident;
  }
}

}  // namespace capture
