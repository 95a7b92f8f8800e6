// One whole capture: plan, session folder, frames, maps, report. What `ssrig capture` and the
// daemon do with a rig that is open.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/exit_code.h"
#include "capture/motion_file.h"
#include "capture/plan.h"
#include "capture/resumption.h"
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
  // A session that was interrupted, to be finished: then subject, directory and name are its own.
  std::filesystem::path resume;
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
  // Errors: a result with kUsage or kStorage; nothing was written but the directory. To resume,
  // every frame on the disk is read, and the take's settings are held against the rig file's.
  static tl::expected<CaptureJob, CaptureResult> prepare(const rig::RigFile& rig_file,
                                                         const CaptureOptions& options);

  // On the session thread, devices open. `stop` aborts the capture; maps under way are finished.
  // A resumed take first shows a pattern that it has again: if it moved further than a map could
  // bear, the result is kIncomplete and says by how much, and nothing of the take has changed but
  // its journal. Frames that do not show their pattern (capture/picture_watch.h) are set aside and
  // taken again, as often as sequence.retake_limit says, a repeat after them; what is wrong then
  // fails the capture. What moved is told by the frames that the session has in the end.
  CaptureResult run(Devices devices, const std::stop_token& stop,
                    const OnProgress& on_progress) const;

 private:
  CaptureJob(const rig::RigFile& rig_file, CaptureOptions options, Plan plan,
             estimation::Manifest manifest, std::optional<Resumption> resumption);
  estimation::Result<std::unique_ptr<SessionWriter>> open_session() const;
  Take make_own_take() const;
  int repeat_every() const;
  std::size_t most_waiting_frames() const;
  std::unique_ptr<MotionWatch> make_watch() const;
  WatchedMotion judge_motion(const Devices& devices, const TakeSinks& sinks, int pattern,
                             ProgressTeller& teller) const;
  std::optional<CaptureResult> check_nothing_moved(Devices devices, const std::stop_token& stop,
                                                   SessionWriter& writer, MotionWatch& watch,
                                                   ProgressTeller& teller) const;
  std::optional<WatchedMotion> take_frames(Devices devices, const std::stop_token& stop,
                                           const Take& take, const TakeSinks& sinks,
                                           ProgressTeller& teller, WatchedPictures& pictures,
                                           CaptureResult& result) const;
  // How a capture ends that is not complete.
  struct Shortfall {
    estimation::SessionState state = estimation::SessionState::kFailed;
    ExitCode exit_code = ExitCode::kIncomplete;
    std::string message;
    std::optional<estimation::SessionFailure> failure;
  };
  std::optional<Shortfall> retake_wrong(Devices devices, const std::stop_token& stop,
                                        const TakeSinks& sinks, int repeated,
                                        ProgressTeller& teller, WatchedPictures& pictures) const;

  rig::RigFile rig_file_;
  CaptureOptions options_;
  Plan plan_;
  estimation::Manifest manifest_;
  std::optional<Resumption> resumption_;
};

}  // namespace capture
