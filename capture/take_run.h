// A take on the way: its frames go to those that use them, its progress and journal are told.
#pragma once

#include <functional>
#include <optional>
#include <stop_token>
#include <string>

#include "capture/live_estimate.h"
#include "capture/motion_watch.h"
#include "capture/picture_watch.h"
#include "capture/runner.h"
#include "capture/session_writer.h"
#include "capture/take.h"
#include "rig/rig_file.h"

namespace capture {

struct CaptureProgress {
  enum class Phase { kCapturing, kEstimating };
  Phase phase = Phase::kCapturing;
  int slots_filled = 0;  // of the session; repeats are none of them
  int slots_total = 0;
  int retake_count = 0;
  std::string text;    // what is going on, one clause
  std::string motion;  // what the repeats said, as soon as they have all come
};
// Called on the session thread, at each change.
using OnProgress = std::function<void(const CaptureProgress&)>;

// Tells of progress when there is any: slots, retakes, or the pattern that is shown.
class ProgressTeller {
 public:
  // `slots_before`: filled when the take begins.
  ProgressTeller(int slots_before, int slots_total, const OnProgress& on_progress);
  void tell(const Take& take, const SequenceState& state);
  // Another run of the same capture begins.
  void begin_run(int slots_before) { slots_before_ = slots_before; }
  // The verdict, while frames are still on their way to the disk.
  void tell_motion(const std::string& motion);
  void tell_estimating();

 private:
  void tell() const;
  const OnProgress& on_progress_;
  int slots_before_;
  CaptureProgress progress_;
};

// Where frames go; null where nobody wants them.
struct TakeSinks {
  SessionWriter& writer;
  LiveEstimate* estimate = nullptr;
  MotionWatch* watch = nullptr;
  PictureWatch* pictures = nullptr;
};

// run_capture() of the take's plan by the rig file's rules.
RunResult run_take(Devices devices, const rig::RigFile& rig_file, const Take& take,
                   const TakeSinks& sinks, const std::stop_token& stop, ProgressTeller& teller);

}  // namespace capture
