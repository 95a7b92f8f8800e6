#include "capture/capture_job.h"

#include <memory>
#include <optional>
#include <utility>

#include "capture/live_estimate.h"
#include "capture/motion_file.h"
#include "capture/results.h"
#include "capture/session_plan.h"
#include "capture/session_writer.h"
#include "capture/take_run.h"

namespace capture {
namespace {

using estimation::SessionState;

CaptureResult refusal(ExitCode exit_code, std::string message) {
  CaptureResult result;
  result.exit_code = exit_code;
  result.message = std::move(message);
  return result;
}

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

std::optional<estimation::SessionFailure> describe(const std::optional<Failure>& failure,
                                                   const Take& take) {
  if (!failure) return std::nullopt;
  estimation::SessionFailure described{
      std::string(to_string(failure->incident)), {}, failure->text};
  for (const SlotId slot : failure->slots) described.slots.push_back(take.name_of(slot));
  return described;
}

std::string summary(const RunResult& run, int slot_count) {
  if (run.outcome == Outcome::kAborted) return "aborted; the frames so far are kept";
  if (run.outcome == Outcome::kFailed) return run.failure->text;
  std::string text =
      std::to_string(slot_count) + " of " + std::to_string(slot_count) + " slots filled";
  if (run.retake_count > 0) text += ", " + std::to_string(run.retake_count) + " retaken";
  return text;
}

// Calibrations take frames alone, of what does not breathe.
Take take_of(const Plan& plan, const rig::RigFile& rig_file, CaptureProduct product) {
  return make_take(plan, product == CaptureProduct::kMaps ? rig_file.sequence.repeat_every : 0);
}

std::unique_ptr<MotionWatch> make_watch(const estimation::Manifest& manifest, const Take& take,
                                        const rig::RigFile& rig_file) {
  if (!take.repeated) return nullptr;
  return std::make_unique<MotionWatch>(manifest, *take.repeated, take.plan.exposures.size(),
                                       static_cast<std::size_t>(take.plan.slot_count()),
                                       rig_file.sequence.is_shuffled);
}

// Beside the frames, whatever became of the capture; a reader of sessions needs none of it.
void note_motion(const estimation::MotionReport& report, int pattern, CaptureResult& result) {
  result.motion = report.text;
  if (report.repeats.empty()) return;
  if (const auto written = write_motion(result.session, report, pattern); !written)
    result.notes.push_back("motion not stored: " + written.error().text());
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

  const Take take = take_of(plan_, rig_file_, options_.product);
  const auto watch = make_watch(manifest, take, rig_file_);
  ProgressTeller teller(0, plan_.slot_count(), on_progress);
  const RunResult run =
      run_take(devices, rig_file_, take, {**writer, estimate.get(), watch.get()}, stop, teller);
  result.state = state_of(run.outcome);
  result.exit_code = exit_code_of(run);
  result.message = summary(run, plan_.slot_count());
  if (watch) note_motion(watch->finish(), *take.repeated, result);
  const auto stored = (*writer)->finish(result.state, describe(run.failure, take));
  if (!stored) {
    result.state = SessionState::kFailed;
    result.exit_code = ExitCode::kStorage;
    result.message = stored.error().text();
  }
  if (result.state != SessionState::kComplete || !estimate) return result;

  teller.tell_estimating(result.motion);
  const auto estimated = estimate->finish();
  if (!estimated) {
    result.exit_code = ExitCode::kFailed;
    result.message += "; no maps: " + estimated.error().text();
    return result;
  }
  result.notes.insert(result.notes.end(), estimated->notes.begin(), estimated->notes.end());
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
