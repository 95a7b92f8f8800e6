// One whole capture: plan, session folder, frames, maps, report. What `ssrig capture` and the
// daemon do with a rig that is open.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/exit_code.h"
#include "capture/plan.h"
#include "capture/runner.h"
#include "capture/take_run.h"
#include "estimation/estimator.h"
#include "estimation/session/manifest.h"
#include "rig/rig_file.h"

namespace capture {

// What a capture is to leave behind; frames alone where they are for calibration.
enum class CaptureProduct { kMaps, kFramesAlone };

struct CaptureOptions {
  std::string plan = "paper";
  std::optional<Plan> own_plan = std::nullopt;  // in place of the plan of that name
  CaptureProduct product = CaptureProduct::kMaps;
  std::string subject;
  std::filesystem::path directory = "sessions";
  std::chrono::system_clock::time_point created;  // names the session
  estimation::EstimatorOptions estimator;
};

struct CaptureResult {
  ExitCode exit_code = ExitCode::kFailed;
  std::string message;            // one sentence, with the remedy if there is one to give
  std::filesystem::path session;  // empty: no folder was made
  estimation::SessionState state = estimation::SessionState::kFailed;
  std::string motion;                 // has anything moved, one sentence; empty: not watched
  std::vector<std::string> pictures;  // quick-look files, relative to the session
  std::vector<std::string> notes;     // what could not be computed, and why
};

// Not thread-safe.
class CaptureJob {
 public:
  // Everything that can be wrong before a device is needed: plan, calibration, options, storage.
  // Errors: a result with kUsage or kStorage; nothing was written but the directory.
  static tl::expected<CaptureJob, CaptureResult> prepare(const rig::RigFile& rig_file,
                                                         const CaptureOptions& options);

  // On the session thread, devices open. `stop` aborts the capture; maps under way are finished.
  CaptureResult run(Devices devices, const std::stop_token& stop,
                    const OnProgress& on_progress) const;

 private:
  CaptureJob(const rig::RigFile& rig_file, CaptureOptions options, Plan plan,
             estimation::Manifest manifest);

  rig::RigFile rig_file_;
  CaptureOptions options_;
  Plan plan_;
  estimation::Manifest manifest_;
};

}  // namespace capture
