// ssrig calibrate without sessions: captured one after the other at the rig, with guidance.
#include <cstdio>
#include <string>
#include <vector>

#include "capture/app/calibrate_command.h"
#include "capture/app/console.h"
#include "capture/app/live_rig.h"
#include "capture/calibrate/calibration_plans.h"
#include "capture/calibrate/radiometry_steps.h"

namespace capture {
namespace {

// A pose less than this is worth is worth nobody's time.
constexpr double kSmallGainFrac = 0.05;

void tell(const GeometryJob& job) {
  if (const auto& fit = job.fit())
    std::fprintf(
        stderr, "%zu poses: camera %.3f px, projector %.3f px rms; a depth is known to %.3f mm\n",
        job.pose_count(), fit->camera_rms_px, fit->projector_rms_px, job.check().depth_sd_mm);
  if (job.pose_count() > 0)
    for (const std::string& refusal : job.refusals())
      std::fprintf(stderr, "not yet: %s\n", refusal.c_str());
  std::string advice = job.advice().text;
  if (job.refusals().empty() && job.advice().expected_gain_frac < kSmallGainFrac)
    advice = "this is enough; another pose would change little";
  std::fprintf(stderr, "pose %zu: %s.\nPress Enter to capture it, or type q and Enter to finish.\n",
               job.pose_count() + 1, advice.c_str());
}

ExitCode capture_pose(LiveRig& rig, GeometryJob& job) {
  const CaptureResult result = rig.capture("calibration-pose", board_plan(rig.rig_file()));
  if (result.state != estimation::SessionState::kComplete) return judge_incomplete(result);
  if (const auto added = job.add_session(result.session); !added)
    complain("left out: " + added.error().text());
  job.update();
  return ExitCode::kDone;
}

ExitCode capture_poses_at(LiveRig& rig, GeometryJob& job) {
  for (;;) {
    tell(job);
    const Answer answer = rig.ask();
    if (answer == Answer::kAborted) return ExitCode::kAborted;
    if (answer != Answer::kGo) return ExitCode::kDone;
    const ExitCode captured = capture_pose(rig, job);
    if (captured != ExitCode::kDone) return captured;
  }
}

// True where the step is done with: captured and good, kDone in `exit_code`.
bool capture_step(LiveRig& rig, const RadiometryStep& step, const estimation::Calibration& geometry,
                  RadiometryInputs& inputs, ExitCode& exit_code) {
  const CaptureResult result = rig.capture(step.subject, step.plan);
  if (result.state != estimation::SessionState::kComplete) {
    exit_code = judge_incomplete(result);
    return exit_code != ExitCode::kDone;
  }
  const auto checked = check_step(step, result.session, inputs, geometry);
  if (!checked) {
    complain("this will not do: " + checked.error().text());
    return false;
  }
  for (const std::string& warning : *checked)
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  (inputs.*step.sessions).push_back(result.session.string());
  return true;
}

ExitCode capture_series_at(LiveRig& rig, const estimation::Calibration& geometry,
                           RadiometryInputs& inputs) {
  const std::vector<RadiometryStep> steps = radiometry_steps(rig.rig_file());
  for (std::size_t i = 0; i < steps.size();) {
    std::fprintf(stderr,
                 "step %zu of %zu: %s.\nPress Enter to capture it, type s and Enter to leave it "
                 "out, or q and Enter to finish.\n",
                 i + 1, steps.size(), steps[i].words.c_str());
    const Answer answer = rig.ask();
    if (answer == Answer::kAborted) return ExitCode::kAborted;
    if (answer == Answer::kEnough) return ExitCode::kDone;
    ExitCode exit_code = ExitCode::kDone;
    if (answer == Answer::kSkip || capture_step(rig, steps[i], geometry, inputs, exit_code)) ++i;
    if (exit_code != ExitCode::kDone) return exit_code;
  }
  return ExitCode::kDone;
}

}  // namespace

ExitCode capture_poses(const rig::RigFile& rig_file, GeometryJob& job) {
  return LiveRig::run(rig_file, [&job](LiveRig& rig) { return capture_poses_at(rig, job); });
}

ExitCode capture_series(const rig::RigFile& rig_file, const estimation::Calibration& geometry,
                        RadiometryInputs& inputs) {
  return LiveRig::run(rig_file,
                      [&](LiveRig& rig) { return capture_series_at(rig, geometry, inputs); });
}

}  // namespace capture
