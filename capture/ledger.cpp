#include "capture/ledger.h"

#include <algorithm>
#include <utility>

#include "estimation/base/check.h"

namespace capture {

using estimation::check;
using std::chrono::microseconds;
using std::chrono::nanoseconds;

std::string Ledger::in_us(nanoseconds time) {
  return std::to_string(std::chrono::duration_cast<microseconds>(time).count()) + " us";
}

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
  proved_pulse_number_ = 0;
  least_delay_.reset();
  prompt_pulse_number_ = 0;
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

bool Ledger::is_over(const Showing& showing) const {
  return showing.ended_pulse_count == rules_.brackets_per_showing();
}

// Nothing is awaited of it but frames.
bool Ledger::is_settled(const Showing& showing) const {
  return is_over(showing) && (showing.swapped || showing.is_spoiled);
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

bool Ledger::is_count_proved(std::uint32_t pulse_number) const {
  return pulse_number <= prompt_pulse_number_ ||
         std::all_of(showings_.begin(), showings_.end(),
                     [](const Showing& showing) { return showing.edge || showing.is_edge_lost; });
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

bool Ledger::is_filled(SlotId id) const {
  return std::any_of(slots_.begin(), slots_.end(),
                     [id](const Slot& slot) { return slot.id == id && slot.evidence.has_value(); });
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
