// ssrig capture: one capture, maps included, as a new session folder.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/app/estimator_options.h"
#include "capture/app/interrupts.h"
#include "capture/app/open_rig.h"
#include "capture/capture_job.h"
#include "capture/daemon/daemon_client.h"
#include "capture/doctor/needs.h"
#include "capture/interrupted_takes.h"
#include "nlohmann/json.hpp"
#include "rig/rig_file.h"

namespace capture {
namespace {

struct CaptureArguments {
  std::string rig_file;
  std::string directory;  // empty: the rig file's
  std::string resume;     // a session; empty: a new one
  bool is_json = false;
  CaptureOptions options;
};

std::string describe(const CaptureProgress& progress) {
  if (!progress.motion.empty()) return "motion: " + progress.motion + "; " + progress.text;
  if (progress.phase == CaptureProgress::Phase::kEstimating) return progress.text;
  std::string text = std::to_string(progress.slots_filled) + " of " +
                     std::to_string(progress.slots_total) + " slots, " + progress.text;
  if (progress.retake_count > 0) text += ", " + std::to_string(progress.retake_count) + " retaken";
  return text;
}

void print(const CaptureResult& result, bool is_json) {
  if (is_json) {
    const nlohmann::json json{{"session", result.session.string()},
                              {"state", to_string(result.state)},
                              {"exit_code", static_cast<int>(result.exit_code)},
                              {"message", result.message},
                              {"motion", result.motion},
                              {"pictures", result.pictures},
                              {"notes", result.notes}};
    std::printf("%s\n", json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
  } else if (!result.session.empty()) {
    std::printf("%s\n", result.session.c_str());
  }
  if (!result.motion.empty()) std::fprintf(stderr, "motion: %s\n", result.motion.c_str());
  for (const std::string& note : result.notes) std::fprintf(stderr, "note: %s\n", note.c_str());
  if (result.exit_code == ExitCode::kDone)
    std::fprintf(stderr, "%s\n", result.message.c_str());
  else
    complain(result.message);
}

// The main thread serves the window while a thread of its own runs the session.
CaptureResult drive(OpenRig& rig, const CaptureJob& job, const std::stop_token& stop) {
  ProgressLine line;
  CaptureResult result;
  std::stop_source is_over;
  {
    const std::jthread session([&] {
      result = job.run(rig.devices(), stop, [&line](const CaptureProgress& progress) {
        const bool is_important =
            progress.phase == CaptureProgress::Phase::kEstimating || !progress.motion.empty();
        line.show(describe(progress), is_important);
      });
      is_over.request_stop();
    });
    // A display that fails is a DeviceFault to the session, which then ends by itself.
    if (const auto served = rig.projector().run(is_over.get_token()); !served)
      line.show("projector: " + served.error().detail, true);
  }
  return result;
}

CaptureResult refusal(ExitCode exit_code, std::string message) {
  CaptureResult result;
  result.exit_code = exit_code;
  result.message = std::move(message);
  return result;
}

estimation::SessionState state_from(const std::string& word) {
  using estimation::SessionState;
  for (const SessionState state :
       {SessionState::kComplete, SessionState::kAborted, SessionState::kInterrupted})
    if (to_string(state) == word) return state;
  return SessionState::kFailed;
}

// The rig is in a daemon's hands: it captures, we show how far it is.
CaptureResult ask_daemon(DaemonClient& daemon, const CaptureArguments& arguments,
                         const std::stop_token& stop) {
  const estimation::EstimatorOptions& wanted = arguments.options.estimator;
  if (wanted != estimation::EstimatorOptions{}) {
    return refusal(ExitCode::kUsage,
                   "a daemon holds this rig and estimates with its own options; give them to "
                   "ssrig serve, or use ssrig estimate afterwards");
  }
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const std::string request_id = "cli-" + std::to_string(now.count());
  const std::string directory =
      arguments.directory.empty() ? "" : std::filesystem::absolute(arguments.directory).string();
  const std::string resume = arguments.options.resume.empty()
                                 ? ""
                                 : std::filesystem::absolute(arguments.options.resume).string();
  const auto reply =
      daemon.request_capture({request_id, arguments.options.subject, directory, resume});
  if (!reply.is_accepted) return refusal(ExitCode::kDevice, reply.error);
  ProgressLine line;
  const auto show = [&line](const DaemonSnapshot& snapshot) {
    const bool is_estimating = snapshot.phase == DaemonPhase::kEstimating;
    line.show(describe({.phase = is_estimating ? CaptureProgress::Phase::kEstimating
                                               : CaptureProgress::Phase::kCapturing,
                        .slots_filled = snapshot.slots_filled,
                        .slots_total = snapshot.slots_total,
                        .retake_count = snapshot.retake_count,
                        .text = snapshot.message,
                        .motion = snapshot.motion}),
              is_estimating || !snapshot.motion.empty());
  };
  const auto outcome = daemon.follow(request_id, show, stop);
  if (!outcome)
    return refusal(ExitCode::kDevice,
                   "the daemon has gone; look at its log, and at the newest session folder");
  return {.exit_code = static_cast<ExitCode>(outcome->exit_code),
          .message = outcome->message,
          .session = outcome->session,
          .state = state_from(outcome->state),
          .motion = outcome->motion,
          .pictures = outcome->pictures,
          .notes = outcome->notes};
}

// `rig` is to be let go when everything has been told.
CaptureResult capture_once(CaptureArguments arguments, const std::stop_token& stop,
                           std::unique_ptr<OpenRig>& rig) {
  arguments.options.resume = arguments.resume;
  const auto rig_file = rig::read_rig_file(arguments.rig_file);
  if (!rig_file) return refusal(ExitCode::kUsage, rig_file.error().detail);
  const std::string rig_path = std::filesystem::weakly_canonical(rig_file->path).string();
  if (const auto daemon = DaemonClient::find(rig_file->daemon.port, rig_path))
    return ask_daemon(*daemon, arguments, stop);
  arguments.options.directory = rig_file->storage.directory;
  if (!arguments.directory.empty()) arguments.options.directory = arguments.directory;
  arguments.options.created = std::chrono::system_clock::now();
  if (arguments.options.resume.empty())
    for (const InterruptedTake& take : list_interrupted_takes(arguments.options.directory))
      std::fprintf(stderr, "note: %s; finish it with: %s\n", take.text().c_str(),
                   take.remedy(rig_file->path).c_str());
  const auto job = CaptureJob::prepare(*rig_file, arguments.options);
  if (!job) return job.error();
  std::vector<std::string> problems;
  rig = std::make_unique<OpenRig>(*rig_file);
  const bool is_open = rig->open(stop, problems);
  if (stop.stop_requested()) return refusal(ExitCode::kAborted, "aborted before the first pattern");
  if (!is_open) {
    std::string text;
    for (const std::string& problem : problems) text += (text.empty() ? "" : "\nssrig: ") + problem;
    return refusal(ExitCode::kDevice, text);
  }
  std::fprintf(stderr, "%s\n", rig->projector().report().text.c_str());
  if (const std::string& lack = rig->camera_note(); !lack.empty())
    std::fprintf(stderr, "note: %s\n", lack.c_str());
  for (const std::string& warning : host_warnings(*rig_file))
    std::fprintf(stderr, "note: %s\n", warning.c_str());
  return drive(*rig, *job, stop);
}

}  // namespace

void add_capture_command(CLI::App& program, const Select& select) {
  auto arguments = std::make_shared<CaptureArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command = program.add_subcommand("capture", "one capture, maps included");
  command->add_option("--rig", arguments->rig_file, "the rig file")->required();
  command->add_option("--plan", arguments->options.plan, "which patterns")
      ->check(CLI::IsMember({"paper"}))
      ->capture_default_str();
  command->add_option("--subject", arguments->options.subject, "who or what is photographed");
  // An empty name is a script's mistake, and would capture anew, or elsewhere than it was meant.
  const CLI::Validator is_name(
      [](const std::string& name) { return name.empty() ? "name a folder" : std::string(); }, "",
      "NAME");
  command
      ->add_option("--out", arguments->directory,
                   "where the session folder is made (default: as the rig file says)")
      ->check(is_name);
  command
      ->add_option("--resume", arguments->resume,
                   "a session that was interrupted or failed, to be finished")
      ->check(is_name)
      ->excludes("--subject")
      ->excludes("--out");
  command->add_flag("--json", arguments->is_json, "the result as JSON");
  add_estimator_options(*command, arguments->options.estimator);
  command->callback([arguments, select] {
    select([arguments] {
      const Interrupts interrupts;
      std::unique_ptr<OpenRig> rig;
      const CaptureResult result = capture_once(*arguments, interrupts.stop(), rig);
      print(result, arguments->is_json);
      return leave(std::move(rig), result.exit_code);
    });
  });
}

}  // namespace capture
