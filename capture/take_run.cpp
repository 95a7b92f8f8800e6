#include "capture/take_run.h"

#include <algorithm>
#include <utility>

#include "capture/journal.h"
#include "capture/projector_latency.h"

namespace capture {
namespace {

// Those that want the frames, fed from one place.
class FrameFork final : public FrameConsumer {
 public:
  FrameFork(const Take& take, const TakeSinks& sinks) : take_(take), sinks_(sinks) {}

  void consume(const CapturedFrame& frame) override {
    const TakeEntry& entry = take_.entry(frame.slot);
    if (sinks_.watch != nullptr && entry.is_repeat) sinks_.watch->add_repeat(frame);
    if (sinks_.pictures != nullptr && entry.is_repeat) {
      CapturedFrame repeat = frame;
      repeat.slot.pattern = entry.pattern;
      sinks_.pictures->add_repeat(repeat);
    }
    const auto slot = take_.session_slot(frame.slot);
    if (!slot) return;
    CapturedFrame own = frame;
    own.slot = *slot;
    if (sinks_.watch != nullptr) {
      if (take_.repeated == slot->pattern) sinks_.watch->add_first(own);
      sinks_.watch->add_any(own);
    }
    if (sinks_.pictures != nullptr) sinks_.pictures->add(own);
    sinks_.writer.write(own);
    if (sinks_.estimate != nullptr) sinks_.estimate->add(own);
  }
  std::optional<std::string> failure() const override {
    const auto fault = sinks_.writer.fault();
    return fault ? std::optional(fault->text()) : std::nullopt;
  }

 private:
  const Take& take_;
  const TakeSinks sinks_;
};

// Looking at the clock is an event like any other, but only news when it changed something.
bool is_worth_noting(const Transition& transition) {
  return !std::holds_alternative<TimePassed>(transition.event) || !transition.reacted.empty() ||
         transition.from != name_of(transition.state.phase);
}

// The take that could not begin because the projector's latency is not known.
RunResult unmeasured(const rig::Error& error, const std::stop_token& stop) {
  RunResult result;
  result.outcome = stop.stop_requested() ? Outcome::kAborted : Outcome::kFailed;
  if (result.outcome == Outcome::kFailed)
    result.failure = Failure{incident_of(error.fault),
                             std::nullopt,
                             {},
                             "measuring the projector's latency: " + error.detail};
  return result;
}

}  // namespace

ProgressTeller::ProgressTeller(int slots_before, int slots_total, const OnProgress& on_progress)
    : on_progress_(on_progress), slots_before_(slots_before) {
  progress_.slots_filled = slots_before;
  progress_.slots_total = slots_total;
}

void ProgressTeller::tell(const Take& take, const SequenceState& state) {
  CaptureProgress next = progress_;
  const auto& slots = state.ledger.slots();
  next.slots_filled = slots_before_ + static_cast<int>(std::count_if(
                                          slots.begin(), slots.end(), [&take](const Slot& slot) {
                                            return slot.evidence && take.session_slot(slot.id);
                                          }));
  next.retake_count = retake_count(state);
  const int shown = state.ledger.showing_pattern();
  if (shown == kPrimePattern) {
    next.text = "arming";
  } else {
    const TakeEntry& entry = take.entry({shown, 0});
    next.text =
        (entry.is_repeat ? "repeat of pattern " : "pattern ") + std::to_string(entry.pattern);
  }
  if (const auto* reopening = std::get_if<Reopening>(&state.phase); reopening != nullptr)
    next.text =
        "waiting for the " + std::string(to_string(reopening->lost.front())) + ", which is lost";
  if (next.slots_filled == progress_.slots_filled && next.text == progress_.text &&
      next.retake_count == progress_.retake_count)
    return;
  progress_ = next;
  tell();
}

void ProgressTeller::tell_motion(const std::string& motion) {
  progress_.text = "storing the frames";
  progress_.motion = motion;
  tell();
}

void ProgressTeller::tell_estimating() {
  progress_.phase = CaptureProgress::Phase::kEstimating;
  progress_.text = "computing the maps";
  tell();
}

void ProgressTeller::tell() const {
  if (on_progress_) on_progress_(progress_);
}

RunResult run_take(Devices devices, const rig::RigFile& rig_file, const Take& take,
                   const TakeSinks& sinks, const std::stop_token& stop, ProgressTeller& teller) {
  FrameFork fork(take, sinks);
  const rig::HostTime start = devices.events.now();
  const double refresh_hz = devices.projector.report().measured_refresh_hz;
  SequenceRules rules = make_rules(rig_file, take.plan.exposures, refresh_hz);
  if (rig_file.sequence.sync == rig::SyncMode::kSoftware) {
    const auto latency = measure_latency(devices, rig_file.projector, rules.ledger, stop);
    if (!latency) return unmeasured(latency.error(), stop);
    rules.ledger.latency = *latency;
    sinks.writer.journal(latency_line(*latency));
  }
  return run_capture(devices, take.plan, rig_file.projector, rules, fork, stop,
                     [&](const Transition& transition) {
                       if (is_worth_noting(transition))
                         sinks.writer.journal(journal_line(transition, start));
                       teller.tell(take, transition.state);
                     });
}

}  // namespace capture
