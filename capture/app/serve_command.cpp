// ssrig serve: holds the devices and captures on request, with the operator's page on 127.0.0.1.
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/app/estimator_options.h"
#include "capture/app/interrupts.h"
#include "capture/app/open_rig.h"
#include "capture/capture_job.h"
#include "capture/daemon/http_server.h"
#include "capture/doctor/needs.h"
#include "capture/interrupted_takes.h"
#include "rig/rig_file.h"

namespace capture {
namespace {

using std::chrono::steady_clock;

// Between looks at the devices while nobody captures, and between attempts to open lost ones.
constexpr auto kIdleInterval = std::chrono::milliseconds(200);
constexpr auto kReopenInterval = std::chrono::seconds(2);

struct ServeArguments {
  std::string rig_file;
  int port = 0;  // 0: the rig file's
  estimation::EstimatorOptions estimator;
};

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += (text.empty() ? "" : "\n") + line;
  return text;
}

CaptureOutcome outcome_of(const CaptureRequest& request, const CaptureResult& result) {
  return {
      .request_id = request.request_id,
      .session = result.session.empty() ? "" : std::filesystem::absolute(result.session).string(),
      .state = estimation::to_string(result.state),
      .exit_code = static_cast<int>(result.exit_code),
      .message = result.message,
      .motion = result.motion,
      .pictures = result.pictures,
      .notes = result.notes};
}

// Holds one rig file's devices, and opens them anew when one was lost. Main thread: run(); the
// session thread is its own.
//
//   run() ─► open ─► serve ──device lost──► close ─► open (every 2 s, the page says what is
//   missing) ─► serve ...
//
// A stop is heard in each of them; run() then returns, or ends the process (leave()).
class Daemon {
 public:
  Daemon(rig::RigFile rig_file, estimation::EstimatorOptions estimator)
      : rig_file_(std::move(rig_file)), estimator_(std::move(estimator)) {}

  ExitCode run(int port, const std::stop_token& stop) {
    board_.update([this](DaemonSnapshot& snapshot) {
      snapshot.rig_file = std::filesystem::weakly_canonical(rig_file_.path).string();
      snapshot.rig_name = rig_file_.name;
      snapshot.message = "Opening the devices.";
    });
    // The port first: a second daemon is told so before it disturbs the first one's devices.
    const auto server = HttpServer::start(port, board_, desk_);
    if (!server) {
      complain(server.error().detail);
      return ExitCode::kUsage;
    }
    std::vector<std::string> problems;
    auto rig = std::make_unique<OpenRig>(rig_file_);
    if (!rig->open(stop, problems)) {
      for (const std::string& problem : problems) complain(problem);
      return leave(std::move(rig), stop.stop_requested() ? ExitCode::kDone : ExitCode::kDevice);
    }
    std::fprintf(stderr, "ssrig: open http://127.0.0.1:%d\n", (*server)->port());
    for (const InterruptedTake& take : list_interrupted_takes(rig_file_.storage.directory))
      std::fprintf(stderr, "note: %s; finish it with: %s\n", take.text().c_str(),
                   take.remedy(rig_file_.path).c_str());
    bool is_display_there = true;
    while (!stop.stop_requested() && is_display_there) {
      is_display_there = serve(*rig, stop);
      if (is_display_there) open_again(rig, stop);
    }
    // A new process can have the next X server.
    return leave(std::move(rig), is_display_there ? ExitCode::kDone : ExitCode::kDevice);
  }

 private:
  std::vector<InterruptedSession> interrupted() const {
    std::vector<InterruptedSession> sessions;
    for (const InterruptedTake& take : list_interrupted_takes(rig_file_.storage.directory))
      sessions.push_back({std::filesystem::absolute(take.session).string(), take.text()});
    return sessions;
  }

  // Until `stop`, or until a device is lost. False if it was the X server.
  bool serve(OpenRig& rig, const std::stop_token& stop) {
    board_.update([&](DaemonSnapshot& snapshot) {
      snapshot.phase = DaemonPhase::kReady;
      snapshot.message = "Press capture.";
      snapshot.notes = host_warnings(rig_file_);
      snapshot.notes.insert(snapshot.notes.begin(), rig.projector().report().text);
      if (!rig.camera_note().empty()) snapshot.notes.push_back(rig.camera_note());
      snapshot.interrupted = interrupted();
    });
    std::stop_source is_over;
    const std::stop_callback ends(stop, [&] { is_over.request_stop(); });
    const std::jthread session([&] {
      serve_requests(rig.devices(), is_over.get_token());
      is_over.request_stop();
    });
    const auto served = rig.projector().run(is_over.get_token());
    if (!served) report_fault(served.error().detail);
    is_over.request_stop();
    return served.has_value();
  }

  // The session thread. Returns on stop, or when a device is lost.
  void serve_requests(Devices devices, const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      const auto request = desk_.next_capture(steady_clock::now() + kIdleInterval, stop);
      if (request && capture(devices, *request, stop) == ExitCode::kDevice) return;
      if (!request && was_device_lost(devices.events)) return;
    }
  }

  // Nothing is under way: of what devices say, only faults matter.
  bool was_device_lost(rig::EventSource& events) {
    while (const auto event = events.wait(events.now(), {})) {
      if (const auto* fault = std::get_if<rig::DeviceFault>(&*event)) {
        report_fault(std::string(to_string(fault->device)) + ": " + fault->error.detail);
        return true;
      }
    }
    return false;
  }

  ExitCode capture(Devices devices, const CaptureRequest& request,
                   const std::stop_token& daemon_stop) {
    board_.update([&](DaemonSnapshot& snapshot) {
      snapshot.phase = DaemonPhase::kCapturing;
      snapshot.request_id = request.request_id;
      snapshot.slots_filled = snapshot.slots_total = snapshot.retake_count = 0;
      snapshot.motion.clear();
      snapshot.message = "Starting.";
    });
    std::stop_source abort;
    const std::stop_callback on_abort(desk_.capture_stop(), [&] { abort.request_stop(); });
    const std::stop_callback on_end(daemon_stop, [&] { abort.request_stop(); });
    const CaptureResult result = do_capture(devices, request, abort.get_token());
    if (!result.motion.empty()) std::fprintf(stderr, "motion: %s\n", result.motion.c_str());
    for (const std::string& note : result.notes) std::fprintf(stderr, "note: %s\n", note.c_str());
    if (result.exit_code != ExitCode::kDone) complain(result.message);

    const bool is_lost = result.exit_code == ExitCode::kDevice;
    desk_.capture_finished();
    board_.update([&](DaemonSnapshot& snapshot) {
      snapshot.phase = is_lost ? DaemonPhase::kFault : DaemonPhase::kReady;
      snapshot.message = is_lost ? result.message : "Press capture.";
      snapshot.request_id.clear();
      snapshot.last = outcome_of(request, result);
      snapshot.interrupted = interrupted();
    });
    return result.exit_code;
  }

  CaptureResult do_capture(Devices devices, const CaptureRequest& request,
                           const std::stop_token& stop) {
    const CaptureOptions options{.plan = "paper",
                                 .subject = request.subject,
                                 .directory = request.directory.empty()
                                                  ? rig_file_.storage.directory
                                                  : std::filesystem::path(request.directory),
                                 .resume = request.resume,
                                 .created = std::chrono::system_clock::now(),
                                 .estimator = estimator_};
    const auto job = CaptureJob::prepare(rig_file_, options);
    if (!job) return job.error();
    return job->run(devices, stop, [this](const CaptureProgress& progress) { show(progress); });
  }

  void show(const CaptureProgress& progress) {
    board_.update([&](DaemonSnapshot& snapshot) {
      if (snapshot.phase != DaemonPhase::kAborting) {
        snapshot.phase = progress.phase == CaptureProgress::Phase::kEstimating
                             ? DaemonPhase::kEstimating
                             : DaemonPhase::kCapturing;
      }
      snapshot.slots_filled = progress.slots_filled;
      snapshot.slots_total = progress.slots_total;
      snapshot.retake_count = progress.retake_count;
      snapshot.message = progress.text;
      snapshot.motion = progress.motion;
    });
  }

  // Until it is open, or until `stop`.
  void open_again(std::unique_ptr<OpenRig>& rig, const std::stop_token& stop) {
    // The devices are let go before they are opened again.
    while (rig->close(rig::HostTime::max(), stop) && !stop.stop_requested()) {
      rig = std::make_unique<OpenRig>(rig_file_);
      std::vector<std::string> problems;
      if (rig->open(stop, problems) || stop.stop_requested()) return;
      report_fault(joined(problems));
      // A wait for the stop. A capture can only have been asked for before the loss was seen.
      if (const auto request = desk_.next_capture(steady_clock::now() + kReopenInterval, stop))
        turn_away(*request);
    }
  }

  void turn_away(const CaptureRequest& request) {
    desk_.capture_finished();
    board_.update([&](DaemonSnapshot& snapshot) {
      snapshot.last =
          CaptureOutcome{.request_id = request.request_id,
                         .session = {},
                         .state = estimation::to_string(estimation::SessionState::kFailed),
                         .exit_code = static_cast<int>(ExitCode::kDevice),
                         .message = snapshot.message,
                         .pictures = {},
                         .notes = {}};
    });
  }

  void report_fault(const std::string& text) {
    complain(text);
    board_.update([&](DaemonSnapshot& snapshot) {
      snapshot.phase = DaemonPhase::kFault;
      snapshot.message = text;
    });
  }

  rig::RigFile rig_file_;
  estimation::EstimatorOptions estimator_;
  StateBoard board_;
  CommandDesk desk_{board_};
};

ExitCode serve(const ServeArguments& arguments) {
  const Interrupts interrupts;
  auto rig_file = rig::read_rig_file(arguments.rig_file);
  if (!rig_file) {
    complain(rig_file.error().detail);
    return ExitCode::kUsage;
  }
  // What would fail every capture is said now: calibration, estimator's options, storage.
  const CaptureOptions trial{.plan = "paper",
                             .subject = {},
                             .directory = rig_file->storage.directory,
                             .resume = {},
                             .created = std::chrono::system_clock::now(),
                             .estimator = arguments.estimator};
  if (const auto job = CaptureJob::prepare(*rig_file, trial); !job) {
    complain(job.error().message);
    return job.error().exit_code;
  }
  const int port = arguments.port == 0 ? rig_file->daemon.port : arguments.port;
  return Daemon(std::move(*rig_file), arguments.estimator).run(port, interrupts.stop());
}

}  // namespace

void add_serve_command(CLI::App& program, const Select& select) {
  auto arguments = std::make_shared<ServeArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command =
      program.add_subcommand("serve", "holds the rig; captures from the page on 127.0.0.1");
  command->add_option("--rig", arguments->rig_file, "the rig file")->required();
  command->add_option("--port", arguments->port, "port on 127.0.0.1 (default: the rig file's)")
      ->check(CLI::Range(1, 65535));
  add_estimator_options(*command, arguments->estimator);
  command->callback([arguments, select] { select([arguments] { return serve(*arguments); }); });
}

}  // namespace capture
