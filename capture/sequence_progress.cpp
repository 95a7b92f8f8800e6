#include <utility>

#include "capture/sequence_turn.h"
#include "estimation/base/check.h"

namespace capture {
namespace {

using std::chrono::milliseconds;

// Arming talks to two devices and reads every setting back: a dead camera takes 2.5 s to say so.
constexpr milliseconds kArmDeadline{10'000};
constexpr milliseconds kBlackDeadline{500};
// Frames of no more showings than that are on their way at a time.
constexpr int kOpenShowingLimit = 2;
constexpr int kPacedShowingLimit = 6;
constexpr std::size_t kMostUnconfirmed = 8;  // frames, while later flips are on their way

}  // namespace

void Turn::proceed() {
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
    confirm_anew();  // what was awaited may just have been given up
    if (state().unconfirmed.empty()) end(Outcome::kComplete);
  }
}

void Turn::wait_for_the_showing() {
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

// From a swap until the next picture is asked for: in the refresh before it is to be swapped in.
std::chrono::nanoseconds Turn::pace() {
  const int showing = ledger().showing_bracket() / rules_.ledger.brackets_per_showing();
  const int refreshes = rules_.refreshes_per_showing[static_cast<std::size_t>(showing)];
  return rules_.ledger.refresh_interval * (4 * refreshes - 3) / 4;
}

void Turn::fire() {
  step_.actions.push_back(Fire{});
  state().phase = Exposing{};
}

// Where a flip is told from the one before it by its time: as far apart as pace paced has them.
bool Turn::is_too_early() {
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

// In the midst of the priming, where no level tells: an edge that comes while none is due is that
// of a flip whose own was taken for the flip before.
bool Turn::listens() {
  const bool may_listen = rules_.ledger.relies_on_swaps && !rules_.ledger.latency;
  if (!may_listen || !ledger().has_edge() || std::exchange(state().has_listened, true))
    return false;
  state().phase = Pacing{now_ + rules_.ledger.edge_deadline};
  return true;
}

// Frames that stay late are of a slow link, or of flips that nobody saw: once all that were asked
// for have been seen, or one is missed, it is known (Ledger::is_count_proved()).
bool Turn::must_drain() {
  return is_paced() && rules_.ledger.has_edge_per_bracket &&
         state().unconfirmed.size() > kMostUnconfirmed;
}

void Turn::show_next() {
  if (is_too_early()) return;
  state().phase = Collecting{};
  if (ledger().is_primed()) state().retake_counts.front() = 0;
  while (!state().queue.empty() && ledger().is_filled(state().queue.front()))
    state().queue.pop_front();  // its frame came after all, of an earlier showing
  const int open_count = ledger().open_showing_count();
  if (const int bracket = ledger().next_bracket(); bracket != kNoBracket) {
    show(ledger().showing_pattern(), bracket);
  } else if (!ledger().is_primed()) {
    if (open_count == 0 && !listens()) show(kPrimePattern, 0);
  } else if (ledger().is_complete()) {
    if (state().unconfirmed.empty()) return end(Outcome::kComplete);
    confirm_last();
  } else if (!state().queue.empty()) {
    if (open_count < (is_paced() ? kPacedShowingLimit : kOpenShowingLimit) && !must_drain()) {
      const int pattern = state().queue.front();
      state().queue.pop_front();
      show(pattern, 0);
    }
  } else {
    estimation::check(open_count > 0, "open slots, but nothing is awaited");
  }
}

void Turn::confirm_last() {
  const rig::HostTime deadline = now_ + rules_.ledger.edge_deadline;
  if (!is_confirmed_by_edge()) {
    state().phase = Confirming{ask_for(rig::kBlackPicture), deadline};
    return;
  }
  show(kPrimePattern, 0);
  state().phase = Confirming{};  // until the edge, whose deadline is the ledger's
}

void Turn::darken() {
  state().is_square_light = false;
  state().phase = Darkening{ask_for(rig::kBlackPicture), now_ + rules_.ledger.edge_deadline};
  state().queue.clear();
  for (const int pattern : order_)
    if (!ledger().is_filled(pattern)) state().queue.push_back(pattern);
}

void Turn::arm() {
  const int bracket_count = static_cast<int>(rules_.ledger.exposures.size());
  // The patterns, the priming, what confirms the last, and as many retakes as one may have.
  const int confirming_count = is_confirmed_by_edge() ? 1 : 0;
  const int showing_count = static_cast<int>(state().queue.size()) + rules_.ledger.priming_rounds +
                            confirming_count + rules_.retake_limit;
  ++state().run_id;
  state().phase = Arming{now_ + kArmDeadline};
  step_.actions.push_back(Arm{state().run_id, showing_count * bracket_count});
}

void Turn::show(int pattern, int first_bracket) {
  state().is_square_light = !state().is_square_light;
  const std::uint64_t show_id = ask_for(pattern == kPrimePattern ? rig::kBlackPicture : pattern);
  ledger().open_showing({pattern, first_bracket, show_id, state().is_square_light, now_});
  state().phase = Showing{};
}

void Turn::end(Outcome outcome) {
  discard_unconfirmed();
  state().is_square_light = false;
  state().outcome = outcome;
  state().phase = Blackening{ask_for(rig::kBlackPicture), now_ + kBlackDeadline};
  step_.actions.push_back(Disarm{});
}

std::uint64_t Turn::ask_for(int picture) {
  const std::uint64_t show_id = state().next_show_id++;
  const bool is_dark = picture == rig::kBlackPicture && !state().is_square_light;
  state().dark_show_id = is_dark ? show_id : 0;
  if (!is_dark) state().darkened.reset();
  step_.actions.push_back(Show{{show_id, picture, state().is_square_light}});
  return show_id;
}

}  // namespace capture
