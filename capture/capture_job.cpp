#include "capture/capture_job.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>

#include "capture/journal.h"
#include "capture/live_estimate.h"
#include "capture/results.h"
#include "capture/session_plan.h"
#include "capture/session_writer.h"
#include "capture/stored_pictures.h"
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

std::string wrong_picture_text(const estimation::PictureCheck& check) {
  return "frames of " + name_patterns(check) +
         " do not show their pictures: see that the projector shows every picture for as long as "
         "the square says (frame interpolation and low-latency modes off), or lengthen "
         "trigger.delay_rise_us and trigger.delay_fall_us; " +
         check.text();
}

// Beside the frames, whatever became of the capture; a reader of sessions needs none of it.
void note_motion(const WatchedMotion& motion, CaptureResult& result) {
  result.motion = motion.report.text;
  if (motion.report.repeats.empty()) return;
  if (const auto written = write_motion(result.session, motion); !written)
    result.notes.push_back("motion not stored: " + written.error().text());
}

void add_maps(const estimation::Result<estimation::SessionEstimate>& estimated,
              const estimation::Manifest& manifest, CaptureResult& result) {
  if (!estimated) {
    result.exit_code = ExitCode::kFailed;
    result.message += "; no maps: " + estimated.error().text();
    return;
  }
  result.notes.insert(result.notes.end(), estimated->notes.begin(), estimated->notes.end());
  const auto pictures = write_results(*estimated, manifest, result.session, result.session / "maps",
                                      result.session / "report");
  if (!pictures) {
    result.exit_code = capture::exit_code_of(pictures.error());
    result.message += "; maps not stored: " + pictures.error().text();
    return;
  }
  for (const auto& picture : *pictures)
    result.pictures.push_back(picture.lexically_relative(result.session).string());
}

estimation::MotionRules motion_rules(bool is_shuffled) {
  estimation::MotionRules rules;
  rules.is_shuffled = is_shuffled;
  return rules;
}

// Told of a failure where the session stays as it is.
CaptureResult unfinished(const std::filesystem::path& session, ExitCode exit_code,
                         std::string message) {
  CaptureResult result = refusal(exit_code, std::move(message));
  result.session = session;
  result.state = SessionState::kInterrupted;
  return result;
}

}  // namespace

CaptureJob::CaptureJob(const rig::RigFile& rig_file, CaptureOptions options, Plan plan,
                       estimation::Manifest manifest, std::optional<Resumption> resumption)
    : rig_file_(rig_file),
      options_(std::move(options)),
      plan_(std::move(plan)),
      manifest_(std::move(manifest)),
      resumption_(std::move(resumption)) {}

tl::expected<CaptureJob, CaptureResult> CaptureJob::prepare(const rig::RigFile& rig_file,
                                                            const CaptureOptions& options) {
  if (const auto valid = options.estimator.validate(); !valid)
    return tl::unexpected(refusal(ExitCode::kUsage, valid.error().text()));
  auto plan = options.own_plan ? rig::Result<Plan>(*options.own_plan)
                               : make_plan(options.plan, rig_file.projector, rig_file.sequence);
  if (!plan) return tl::unexpected(refusal(ExitCode::kUsage, plan.error().detail));
  auto manifest = plan_manifest(rig_file, *plan, {options.subject, options.created});
  if (!manifest) return tl::unexpected(refusal(ExitCode::kUsage, manifest.error().text()));
  std::optional<Resumption> resumption;
  if (!options.resume.empty()) {
    auto prepared = prepare_resumption(rig_file, *plan, *manifest, options.resume);
    if (!prepared) return tl::unexpected(refusal(ExitCode::kUsage, prepared.error().text()));
    resumption = std::move(*prepared);
  }
  const auto storage = resumption
                           ? check_storage(resumption->session, needed_bytes(resumption->lacking()))
                           : check_storage(options.directory, needed_bytes(*manifest));
  if (!storage) return tl::unexpected(refusal(ExitCode::kStorage, storage.error().text()));
  return CaptureJob(rig_file, options, std::move(*plan), std::move(*manifest),
                    std::move(resumption));
}

estimation::Result<std::unique_ptr<SessionWriter>> CaptureJob::open_session() const {
  if (!resumption_)
    return SessionWriter::create(options_.directory, manifest_, rig_file_.calibration_file,
                                 begin_line(rig_file_, plan_, make_own_take()));
  return SessionWriter::go_on(resumption_->session, resumption_->manifest, resumption_->is_good,
                              resumption_->journal_byte_count);
}

// Calibrations take frames alone, of what does not breathe.
int CaptureJob::repeat_every() const {
  return options_.product == CaptureProduct::kMaps ? rig_file_.sequence.repeat_every : 0;
}

// What is to be shown; of a take that is resumed, what it lacks.
Take CaptureJob::make_own_take() const {
  if (!resumption_) return make_take(plan_, repeat_every());
  return make_take(plan_, resumption_->is_open(),
                   resumption_->known_pattern(plan_).value_or(plan_.order.front()), repeat_every());
}

// Of one run: every frame, and the first showing's once more.
std::size_t CaptureJob::most_waiting_frames() const {
  return static_cast<std::size_t>(make_take(plan_, repeat_every()).plan.slot_count()) +
         plan_.exposures.size();
}

// Of a resumed take, the first showing is on the disk, as far as it is there.
std::unique_ptr<MotionWatch> CaptureJob::make_watch() const {
  const auto known = resumption_ ? resumption_->known_pattern(plan_) : std::nullopt;
  const int pattern = known.value_or(plan_.order.front());
  const std::size_t bracket_count = plan_.exposures.size();
  std::vector<int> brackets;
  for (std::size_t bracket = 0; bracket < bracket_count; ++bracket)
    if (!known || resumption_->is_good[static_cast<std::size_t>(pattern) * bracket_count + bracket])
      brackets.push_back(static_cast<int>(bracket));
  return std::make_unique<MotionWatch>(manifest_, pattern, std::move(brackets),
                                       most_waiting_frames());
}

// Has rig or subject moved since the take was interrupted? Nullopt: no, or there is nothing to
// compare with.
std::optional<CaptureResult> CaptureJob::check_nothing_moved(Devices devices,
                                                             const std::stop_token& stop,
                                                             SessionWriter& writer,
                                                             MotionWatch& watch,
                                                             ProgressTeller& teller) const {
  const auto known = resumption_->known_pattern(plan_);
  if (!known || resumption_->good_count() == plan_.slot_count()) return std::nullopt;
  const Take check = make_repeat(plan_, *known);
  const auto& session = resumption_->session;
  if (const auto shown = show_first(*resumption_, *known, watch); !shown)
    return unfinished(session, ExitCode::kFailed, shown.error().text());
  writer.journal(resume_line(resumption_->good_count(), check));
  const RunResult run =
      run_take(devices, rig_file_, check, {writer, nullptr, &watch}, stop, teller);
  if (run.outcome != Outcome::kComplete)
    return unfinished(session, exit_code_of(run),
                      run.outcome == Outcome::kAborted
                          ? "aborted; the take is as it was"
                          : "the take is as it was: " + run.failure->text);
  // A step between two halves of a sweep costs what drift in order does.
  const estimation::MotionReport report = watch.judge(motion_rules(false));
  if (report.verdict == estimation::MotionVerdict::kGood ||
      report.verdict == estimation::MotionVerdict::kUsable)
    return std::nullopt;
  std::string text = "the take cannot be finished, for things are no longer as they were: ";
  for (std::size_t i = 0; i < report.reasons.size(); ++i)
    text.append(i == 0 ? "" : "; ").append(report.reasons[i]);
  writer.journal(refusal_line(text));
  CaptureResult result =
      unfinished(session, ExitCode::kIncomplete, text + "; put them back, or capture anew");
  result.motion = report.text;
  return result;
}

CaptureResult CaptureJob::run(Devices devices, const std::stop_token& stop,
                              const OnProgress& on_progress) const {
  auto writer = open_session();
  if (!writer) return refusal(ExitCode::kStorage, writer.error().text());
  const int good_count = resumption_ ? resumption_->good_count() : 0;
  ProgressTeller teller(good_count, plan_.slot_count(), on_progress);
  const auto watch = make_watch();
  if (resumption_) {
    if (auto moved = check_nothing_moved(devices, stop, **writer, *watch, teller))
      return std::move(*moved);
    if (const auto aside = set_damaged_aside(*resumption_); !aside)
      return unfinished(resumption_->session, ExitCode::kStorage, aside.error().text());
  }
  CaptureResult result;
  result.session = (*writer)->folder();
  const estimation::Manifest manifest = (*writer)->manifest();
  std::unique_ptr<LiveEstimate> estimate;  // of a resumed take the maps come from the disk
  if (options_.product == CaptureProduct::kMaps && !resumption_) {
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
  const Take take = make_own_take();
  PictureWatch picture_watch(manifest_, most_waiting_frames());
  WatchedPictures pictures;
  auto motion =
      take_frames(devices, stop, take,
                  {**writer, estimate.get(), take.repeated ? watch.get() : nullptr, &picture_watch},
                  teller, pictures, result);
  if (result.state != SessionState::kComplete || options_.product != CaptureProduct::kMaps)
    return result;
  if (!pictures.retaken.empty()) estimate.reset();  // it has the frames that were wrong
  teller.tell_estimating();
  const auto estimated = estimate
                             ? estimate->finish()
                             : estimation::estimate_session(result.session, options_.estimator);
  if (estimated && motion) {
    motion->report = watch->judge_by(estimated->maps, motion_rules(rig_file_.sequence.is_shuffled));
    note_motion(*motion, result);
  }
  add_maps(estimated, manifest, result);
  return result;
}

// Says what the repeats say as soon as it is known, ahead of frames on their way to the disk.
WatchedMotion CaptureJob::judge_motion(const Devices& devices, const TakeSinks& sinks, int pattern,
                                       ProgressTeller& teller) const {
  WatchedMotion motion{
      sinks.watch->judge(motion_rules(rig_file_.sequence.is_shuffled)), pattern, {}};
  teller.tell_motion(motion.report.text);
  const rig::HostTime told = devices.events.now();
  motion.verdict_time = told - sinks.watch->last_arrival().value_or(told);
  sinks.writer.journal(motion_line(to_string(motion.report.verdict), motion.verdict_time));
  return motion;
}

// The rig still stands there: slots whose frames do not show their pattern are shown again, and a
// repeat after them. Nullopt: all do, or cannot be checked.
std::optional<CaptureJob::Shortfall> CaptureJob::retake_wrong(Devices devices,
                                                              const std::stop_token& stop,
                                                              const TakeSinks& sinks, int repeated,
                                                              ProgressTeller& teller,
                                                              WatchedPictures& pictures) const {
  for (int retake = 0;; ++retake) {
    pictures.check = sinks.pictures->judge();
    if (sinks.watch != nullptr) sinks.watch->forget_repeats(pictures.check.wrong_repeats_s);
    sinks.writer.journal(picture_line(pictures.check));
    const auto& wrong = pictures.check.wrong;
    if (wrong.empty()) return std::nullopt;
    if (retake == rig_file_.sequence.retake_limit) {
      estimation::SessionFailure failure{"wrong picture", {}, wrong_picture_text(pictures.check)};
      for (const auto& each : wrong)
        failure.slots.push_back(to_string(SlotId{each.pattern, each.bracket}));
      return Shortfall{SessionState::kFailed, ExitCode::kIncomplete, failure.text, failure};
    }
    std::vector<bool> is_open(static_cast<std::size_t>(plan_.slot_count()), false);
    for (const auto& each : wrong) {
      is_open[static_cast<std::size_t>(each.pattern) * plan_.exposures.size() +
              static_cast<std::size_t>(each.bracket)] = true;
      sinks.writer.set_aside({each.pattern, each.bracket});
    }
    pictures.retaken.insert(pictures.retaken.end(), wrong.begin(), wrong.end());
    const Take take = make_take(plan_, is_open, repeated, repeat_every());
    sinks.writer.journal(retake_line(take));
    teller.begin_run(plan_.slot_count() - take.open_slot_count());
    const RunResult run =
        run_take(devices, rig_file_, take, {sinks.writer, nullptr, sinks.watch, sinks.pictures},
                 stop, teller);
    if (run.outcome != Outcome::kComplete) {
      std::string message = summary(run, plan_.slot_count());
      if (run.outcome == Outcome::kFailed)
        message = wrong_picture_text(pictures.check).append("; taken again: ").append(message);
      return Shortfall{state_of(run.outcome), exit_code_of(run), message,
                       describe(run.failure, take)};
    }
  }
}

// Fills the slots that are open and ends the session as complete, failed or aborted.
std::optional<WatchedMotion> CaptureJob::take_frames(Devices devices, const std::stop_token& stop,
                                                     const Take& take, const TakeSinks& sinks,
                                                     ProgressTeller& teller,
                                                     WatchedPictures& pictures,
                                                     CaptureResult& result) const {
  if (resumption_) {
    sinks.writer.journal(resume_line(resumption_->good_count(), take));
    sinks.pictures->know(resumption_->pictures);
  }
  RunResult run;
  run.outcome = Outcome::kComplete;  // where nothing is open: killed before its manifest
  if (take.open_slot_count() > 0) run = run_take(devices, rig_file_, take, sinks, stop, teller);
  result.state = state_of(run.outcome);
  result.exit_code = exit_code_of(run);
  result.message = summary(run, plan_.slot_count());
  if (resumption_ && run.outcome == Outcome::kComplete)
    result.message +=
        ", " + std::to_string(resumption_->good_count()) + " of them before the interruption";
  std::optional<WatchedMotion> motion;
  if (sinks.watch != nullptr) {
    motion = judge_motion(devices, sinks, *take.repeated, teller);
    note_motion(*motion, result);
  }
  auto failure = describe(run.failure, take);
  if (run.outcome == Outcome::kComplete) {
    const int repeated = take.repeated.value_or(plan_.order.front());
    if (auto shortfall = retake_wrong(devices, stop, sinks, repeated, teller, pictures)) {
      result.state = shortfall->state;
      result.exit_code = shortfall->exit_code;
      result.message = std::move(shortfall->message);
      failure = std::move(shortfall->failure);
    } else if (!pictures.retaken.empty()) {
      result.message += ", " + std::to_string(pictures.retaken.size()) +
                        " of them again because the first did not show its pattern";
      if (motion) motion = judge_motion(devices, sinks, repeated, teller);
    }
    if (motion) {
      motion->pictures = pictures;
      note_motion(*motion, result);
    }
  }
  const auto stored = sinks.writer.finish(result.state, std::move(failure));
  if (stored) return motion;
  result.state = SessionState::kFailed;
  result.exit_code = ExitCode::kStorage;
  result.message = stored.error().text();
  return motion;
}

}  // namespace capture
