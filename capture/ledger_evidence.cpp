// What devices tell of a showing: swap, edge and pulses, held against each other.
#include <utility>

#include "capture/ledger.h"

namespace capture {
namespace {

using std::chrono::nanoseconds;

// The camera's clock is read when it is armed, and drifts by up to 50 ppm from then on: 40 s.
constexpr nanoseconds kCameraTimeUncertainty{2'000'000};
// From asking for a picture to the report of its swap: up to a refresh to the vertical blank, and
// as much again.
constexpr int kPunctualRefreshes = 2;

}  // namespace

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

Findings Ledger::edge_seen(const rig::EdgeSeen& edge, rig::HostTime now) {
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
  // From hearing of it: a device's clock may say anything, and neither puts off a deadline nor
  // brings it on.
  showing->due = now + train_length(*showing) + rules_.edge_deadline;
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
  const nanoseconds since = edge.time - showing->edge->time;
  const bool is_flip_due = without_edge() != nullptr;
  // Flips are a refresh apart, however late.
  if (since <= rules_.debounce && (!is_flip_due || since <= rules_.refresh_interval / 2)) {
    showing->is_level_gone = edge.is_light != showing->edge->is_light;
    return {};
  }
  // One that the box did not answer: the count of edges is no longer that of flips.
  if (is_flip_due)
    return {about(
        *showing, Incident::kEdgeOutOfOrder,
        "the light changed " + in_us(since) + " after the edge, and another flip was on its way")};
  return {about(*showing, Incident::kEdgeDuringExposure,
                "the light changed " + in_us(since) + " after the edge")};
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

}  // namespace capture
