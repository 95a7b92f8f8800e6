// ssrig calibrate geometry without --sessions: poses captured one after the other, with guidance.
#include <poll.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <optional>
#include <string>
#include <thread>

#include "capture/app/calibrate_command.h"
#include "capture/app/console.h"
#include "capture/app/interrupts.h"
#include "capture/app/open_rig.h"
#include "capture/capture_job.h"
#include "estimation/calibration/calibration_file.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

// A pose less than this is worth is worth nobody's time.
constexpr double kSmallGainFrac = 0.05;

// A rig without a calibration yet: sessions must carry one, so they get the devices' sizes with
// lenses of a usual length.
std::optional<fs::path> nominal_calibration(const rig::RigFile& rig_file) {
  const auto lens = [](int width_px, int height_px) {
    estimation::Lens nominal;
    nominal.K = estimation::Mat3(2.0 * width_px, 0, (width_px - 1) / 2.0, 0, 2.0 * width_px,
                                 (height_px - 1) / 2.0, 0, 0, 1);
    return nominal;
  };
  estimation::Calibration calibration;
  calibration.camera = lens(rig_file.camera.width_px, rig_file.camera.height_px);
  calibration.projector = lens(rig_file.projector.width_px, rig_file.projector.height_px);
  const auto text = estimation::format_calibration(
      "", calibration,
      {estimation::CalibrationPart::kGeometry, R"({"note": "nominal, before any calibration"})"});
  const fs::path path = rig_file.storage.directory / "nominal_calibration.json";
  if (!text || !estimation::save_text(path, *text)) return std::nullopt;
  return path;
}

enum class Answer { kGo, kEnough, kAborted };

// A line on standard input: empty goes on, anything else ends; as its end does.
Answer ask(const std::stop_token& stop) {
  std::string line;
  while (!stop.stop_requested()) {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    constexpr int kPatienceMs = 200;
    if (::poll(&input, 1, kPatienceMs) <= 0) continue;
    char c = 0;
    if (::read(STDIN_FILENO, &c, 1) != 1) return Answer::kEnough;
    if (c == '\n') return line.empty() ? Answer::kGo : Answer::kEnough;
    line += c;
  }
  return Answer::kAborted;
}

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

// One pose: a capture like any other, whose maps nobody needs. kDone also where the pose was no
// good: the next one may be.
ExitCode capture_pose(const rig::RigFile& rig_file, Devices devices, const std::stop_token& stop,
                      GeometryJob& job) {
  CaptureOptions options;
  options.subject = "calibration-pose";
  options.directory = rig_file.storage.directory;
  options.created = std::chrono::system_clock::now();
  options.estimator.is_geometry_only = true;
  const auto prepared = CaptureJob::prepare(rig_file, options);
  if (!prepared) {
    complain(prepared.error().message);
    return prepared.error().exit_code;
  }
  CaptureResult result;
  {
    ProgressLine line;
    result = prepared->run(devices, stop, [&line](const CaptureProgress& progress) {
      line.show(progress.text + ", " + std::to_string(progress.slots_filled) + " of " +
                std::to_string(progress.slots_total));
    });
  }
  if (result.state != estimation::SessionState::kComplete) {
    complain(result.message);
    return result.exit_code == ExitCode::kIncomplete ? ExitCode::kDone : result.exit_code;
  }
  if (const auto added = job.add_session(result.session); !added)
    complain("left out: " + added.error().text());
  job.update();
  return ExitCode::kDone;
}

ExitCode capture_while_asked(const rig::RigFile& rig_file, OpenRig& rig,
                             const std::stop_token& stop, GeometryJob& job) {
  for (;;) {
    tell(job);
    const Answer answer = ask(stop);
    if (answer == Answer::kAborted) return ExitCode::kAborted;
    if (answer == Answer::kEnough) return ExitCode::kDone;
    const ExitCode captured = capture_pose(rig_file, rig.devices(), stop, job);
    if (captured != ExitCode::kDone) return captured;
  }
}

}  // namespace

ExitCode capture_poses(rig::RigFile rig_file, GeometryJob& job) {
  const Interrupts interrupts;
  std::error_code unknown;  // then the capture says why
  if (!fs::exists(rig_file.calibration_file, unknown))
    if (const auto nominal = nominal_calibration(rig_file)) rig_file.calibration_file = *nominal;
  std::vector<std::string> problems;
  const auto rig = OpenRig::open(rig_file, problems);
  if (!rig) {
    for (const std::string& problem : problems) complain(problem);
    return ExitCode::kDevice;
  }
  ExitCode exit_code = ExitCode::kFailed;
  std::stop_source is_over;
  {
    // The main thread serves the window while a thread of its own runs the poses.
    const std::jthread session([&] {
      exit_code = capture_while_asked(rig_file, *rig, interrupts.stop(), job);
      is_over.request_stop();
    });
    if (const auto served = rig->projector().run(is_over.get_token()); !served)
      complain("projector: " + served.error().detail);
  }
  return exit_code;
}

}  // namespace capture
