// A rig in an operator's hands: captures of frames alone, one after the other, each when asked for.
#pragma once

#include <functional>
#include <stop_token>
#include <string>

#include "capture/app/open_rig.h"
#include "capture/capture_job.h"
#include "capture/exit_code.h"
#include "rig/rig_file.h"

namespace capture {

enum class Answer { kGo, kSkip, kEnough, kAborted };

// Lives on the session thread.
class LiveRig {
 public:
  // Opens the devices, runs `work` on a thread of its own while the calling (main) thread serves
  // the projector's window, and returns its exit code, or says which device failed. Without a
  // calibration file sessions carry nominal lenses. Unless all went well it may be the end of the
  // process (leave() in open_rig.h).
  static ExitCode run(rig::RigFile rig_file, const std::function<ExitCode(LiveRig&)>& work);

  const rig::RigFile& rig_file() const { return rig_file_; }
  // Waits for a line on standard input: empty goes on, "s" skips, anything else ends; as its end
  // does.
  Answer ask() const;
  // One session in the rig's storage folder, every frame kept.
  CaptureResult capture(const std::string& subject, const Plan& plan) const;

 private:
  LiveRig(const rig::RigFile& rig_file, OpenRig& rig, const std::stop_token& stop)
      : rig_file_(rig_file), rig_(rig), stop_(stop) {}

  const rig::RigFile& rig_file_;
  OpenRig& rig_;
  std::stop_token stop_;
};

// What a step's capture that did not complete means for the whole: kDone, and the reason said,
// where it may be tried again.
ExitCode judge_incomplete(const CaptureResult& result);

}  // namespace capture
