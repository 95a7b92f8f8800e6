#include "capture/app/live_rig.h"

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <memory>
#include <optional>
#include <system_error>
#include <thread>

#include "capture/app/console.h"
#include "capture/app/interrupts.h"
#include "estimation/calibration/calibration_file.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

// A rig without a calibration yet: sessions must carry one, so they get the devices' sizes with
// lenses of a usual length, the projector a hand's breadth beside the camera.
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
  calibration.projector_from_camera_mm = {200, 0, 0};
  const auto text = estimation::format_calibration(
      "", calibration,
      {estimation::CalibrationPart::kGeometry, R"({"note": "nominal, before any calibration"})"});
  const fs::path path = rig_file.storage.directory / "nominal_calibration.json";
  if (!text || !estimation::save_text(path, *text)) return std::nullopt;
  return path;
}

}  // namespace

ExitCode LiveRig::run(rig::RigFile rig_file, const std::function<ExitCode(LiveRig&)>& work) {
  const Interrupts interrupts;
  std::error_code unknown;  // then the capture says why
  if (!fs::exists(rig_file.calibration_file, unknown))
    if (const auto nominal = nominal_calibration(rig_file)) rig_file.calibration_file = *nominal;
  std::vector<std::string> problems;
  auto rig = std::make_unique<OpenRig>(rig_file);
  if (!rig->open(interrupts.stop(), problems)) {
    for (const std::string& problem : problems) complain(problem);
    const bool is_aborted = interrupts.stop().stop_requested();
    return leave(std::move(rig), is_aborted ? ExitCode::kAborted : ExitCode::kDevice);
  }
  ExitCode exit_code = ExitCode::kFailed;
  std::stop_source is_over;
  {
    LiveRig live(rig_file, *rig, interrupts.stop());
    const std::jthread session([&] {
      exit_code = work(live);
      is_over.request_stop();
    });
    if (const auto served = rig->projector().run(is_over.get_token()); !served)
      complain("projector: " + served.error().detail);
  }
  // Only where the work was done is there more to come.
  return exit_code == ExitCode::kDone ? exit_code : leave(std::move(rig), exit_code);
}

Answer LiveRig::ask() const {
  std::string line;
  while (!stop_.stop_requested()) {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    constexpr int kPatienceMs = 200;
    if (::poll(&input, 1, kPatienceMs) <= 0) continue;
    char c = 0;
    if (::read(STDIN_FILENO, &c, 1) != 1) return Answer::kEnough;
    if (c != '\n') {
      line += c;
      continue;
    }
    if (line.empty()) return Answer::kGo;
    return line == "s" ? Answer::kSkip : Answer::kEnough;
  }
  return Answer::kAborted;
}

CaptureResult LiveRig::capture(const std::string& subject, const Plan& plan) const {
  CaptureOptions options;
  options.subject = subject;
  options.own_plan = plan;
  options.product = CaptureProduct::kFramesAlone;
  options.directory = rig_file_.storage.directory;
  options.created = std::chrono::system_clock::now();
  const auto job = CaptureJob::prepare(rig_file_, options);
  if (!job) return job.error();
  ProgressLine line;
  return job->run(rig_.devices(), stop_, [&line](const CaptureProgress& progress) {
    line.show(progress.text + ", " + std::to_string(progress.slots_filled) + " of " +
              std::to_string(progress.slots_total));
  });
}

ExitCode judge_incomplete(const CaptureResult& result) {
  complain(result.message);
  return result.exit_code == ExitCode::kIncomplete ? ExitCode::kDone : result.exit_code;
}

}  // namespace capture
