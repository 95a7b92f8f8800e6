#include "capture/capture_job.h"

#include <memory>
#include <optional>
#include <utility>

#include "capture/journal.h"
#include "capture/live_estimate.h"
#include "capture/results.h"
#include "capture/session_plan.h"
#include "capture/session_writer.h"

namespace capture {
namespace {

using estimation::SessionState;

CaptureResult refusal(ExitCode exit_code, std::string message) {
  CaptureResult result;
  result.exit_code = exit_code;
  result.message = std::move(message);
  return result;
}

// Both that want the frames, fed from one place; `estimate` is null where nobody wants maps.
class FrameFork final : public FrameConsumer {
 public:
  FrameFork(SessionWriter& writer, LiveEstimate* estimate) : writer_(writer), estimate_(estimate) {}
  void consume(const CapturedFrame& frame) override {
    writer_.write(frame);
    if (estimate_ != nullptr) estimate_->add(frame);
  }
  std::optional<std::string> failure() const override {
    const auto fault = writer_.fault();
    return fault ? std::optional(fault->text()) : std::nullopt;
  }

 private:
  SessionWriter& writer_;
  LiveEstimate* estimate_;
};

SessionState state_of(Outcome outcome) {
  switch (outcome) {
    case Outcome::kComplete:
      return SessionState::kComplete;
    case Outcome::kFailed:
      return SessionState::kFailed;
    case Outcome::kAborted:
      return SessionState::kAborted;
  }
  return SessionState::kFailed;
}

ExitCode exit_code_of(const RunResult& run) {
  if (run.outcome == Outcome::kComplete) return ExitCode::kDone;
  if (run.outcome == Outcome::kAborted) return ExitCode::kAborted;
  switch (run.failure->incident) {
    case Incident::kDeviceLost:
    case Incident::kDeviceRefused:
      return ExitCode::kDevice;
    case Incident::kStorage:
      return ExitCode::kStorage;
    default:
      return ExitCode::kIncomplete;
  }
}

std::optional<estimation::SessionFailure> describe(const std::optional<Failure>& failure) {
  if (!failure) return std::nullopt;
  estimation::SessionFailure described{
      std::string(to_string(failure->incident)), {}, failure->text};
  for (const SlotId slot : failure->slots) described.slots.push_back(to_string(slot));
  return described;
}

// Tells of progress when there is any: slots, retakes, or the pattern that is shown.
class ProgressTeller {
 public:
  ProgressTeller(int slot_count, const OnProgress& on_progress) : on_progress_(on_progress) {
    progress_.slots_total = slot_count;
  }
  void tell(const SequenceState& state) {
    CaptureProgress next = progress_;
    next.slots_filled = state.ledger.filled_count();
    next.retake_count = retake_count(state);
    const int pattern = state.ledger.showing_pattern();
    next.text = pattern == kPrimePattern ? "arming" : "pattern " + std::to_string(pattern);
    if (const auto* reopening = std::get_if<Reopening>(&state.phase); reopening != nullptr)
      next.text =
          "waiting for the " + std::string(to_string(reopening->lost.front())) + ", which is lost";
    if (next.slots_filled == progress_.slots_filled && next.text == progress_.text &&
        next.retake_count == progress_.retake_count)
      return;
    progress_ = next;
    tell();
  }
  void tell_estimating() {
    progress_.phase = CaptureProgress::Phase::kEstimating;
    progress_.text = "computing the maps";
    tell();
  }

 private:
  void tell() const {
    if (on_progress_) on_progress_(progress_);
  }
  const OnProgress& on_progress_;
  CaptureProgress progress_;
};

// Looking at the clock is an event like any other, but only news when it changed something.
bool is_worth_noting(const Transition& transition) {
  return !std::holds_alternative<TimePassed>(transition.event) || !transition.reacted.empty() ||
         transition.from != name_of(transition.state.phase);
}

std::string summary(const RunResult& run) {
  if (run.outcome == Outcome::kAborted) return "aborted; the frames so far are kept";
  if (run.outcome == Outcome::kFailed) return run.failure->text;
  std::string text = std::to_string(run.slots.size()) + " of " + std::to_string(run.slots.size()) +
                     " slots filled";
  if (run.retake_count > 0) text += ", " + std::to_string(run.retake_count) + " retaken";
  return text;
}

}  // namespace

CaptureJob::CaptureJob(const rig::RigFile& rig_file, CaptureOptions options, Plan plan,
                       estimation::Manifest manifest)
    : rig_file_(rig_file),
      options_(std::move(options)),
      plan_(std::move(plan)),
      manifest_(std::move(manifest)) {}

tl::expected<CaptureJob, CaptureResult> CaptureJob::prepare(const rig::RigFile& rig_file,
                                                            const CaptureOptions& options) {
  if (const auto valid = options.estimator.validate(); !valid)
    return tl::unexpected(refusal(ExitCode::kUsage, valid.error().text()));
  auto plan = options.own_plan ? rig::Result<Plan>(*options.own_plan)
                               : make_plan(options.plan, rig_file.projector, rig_file.sequence);
  if (!plan) return tl::unexpected(refusal(ExitCode::kUsage, plan.error().detail));
  auto manifest = plan_manifest(rig_file, *plan, {options.subject, options.created});
  if (!manifest) return tl::unexpected(refusal(ExitCode::kUsage, manifest.error().text()));
  if (const auto storage = check_storage(options.directory, needed_bytes(*manifest)); !storage)
    return tl::unexpected(refusal(ExitCode::kStorage, storage.error().text()));
  return CaptureJob(rig_file, options, std::move(*plan), std::move(*manifest));
}

CaptureResult CaptureJob::run(Devices devices, const std::stop_token& stop,
                              const OnProgress& on_progress) const {
  auto writer = SessionWriter::create(options_.directory, manifest_, rig_file_.calibration_file);
  if (!writer) return refusal(ExitCode::kStorage, writer.error().text());
  CaptureResult result;
  result.session = (*writer)->folder();
  const estimation::Manifest manifest = (*writer)->manifest();
  std::unique_ptr<LiveEstimate> estimate;
  if (options_.product == CaptureProduct::kMaps) {
    auto started = LiveEstimate::start(manifest, result.session, options_.estimator);
    if (!started) {
      result.message = started.error().text();
      result.exit_code = ExitCode::kUsage;
      // Told above; the manifest's own fate does not change it.
      std::ignore = (*writer)->finish(SessionState::kFailed,
                                      estimation::SessionFailure{"estimator", {}, result.message});
      return result;
    }
    estimate = *std::move(started);
  }

  FrameFork fork(**writer, estimate.get());
  ProgressTeller teller(plan_.slot_count(), on_progress);
  const rig::HostTime start = devices.events.now();
  const double refresh_hz = devices.projector.report().measured_refresh_hz;
  SequenceRules rules = make_rules(rig_file_, refresh_hz);
  rules.ledger.exposures = plan_.exposures;
  const RunResult run = run_capture(devices, plan_, rig_file_.projector, rules, fork, stop,
                                    [&](const Transition& transition) {
                                      if (is_worth_noting(transition))
                                        (*writer)->journal(journal_line(transition, start));
                                      teller.tell(transition.state);
                                    });
  result.state = state_of(run.outcome);
  result.exit_code = exit_code_of(run);
  result.message = summary(run);
  const auto stored = (*writer)->finish(result.state, describe(run.failure));
  if (!stored) {
    result.state = SessionState::kFailed;
    result.exit_code = ExitCode::kStorage;
    result.message = stored.error().text();
  }
  if (result.state != SessionState::kComplete || !estimate) return result;

  teller.tell_estimating();
  const auto estimated = estimate->finish();
  if (!estimated) {
    result.exit_code = ExitCode::kFailed;
    result.message += "; no maps: " + estimated.error().text();
    return result;
  }
  result.notes = estimated->notes;
  const auto pictures = write_results(*estimated, manifest, result.session, result.session / "maps",
                                      result.session / "report");
  if (!pictures) {
    result.exit_code = capture::exit_code_of(pictures.error());
    result.message += "; maps not stored: " + pictures.error().text();
    return result;
  }
  for (const auto& picture : *pictures)
    result.pictures.push_back(picture.lexically_relative(result.session).string());
  return result;
}

}  // namespace capture
