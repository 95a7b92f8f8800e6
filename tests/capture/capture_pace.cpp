// How long a capture takes, by sync mode and pace, on the virtual clock: 88 patterns of two
// exposures, for projectors of different lag and cameras of different link. As Markdown.
#include <cstdio>

#include "tests/capture/ledger_rig.h"

namespace {

using std::chrono::duration;
using std::chrono::microseconds;

struct Mode {
  const char* name;
  rig::SyncMode sync;
  rig::Pace pace;
};

// Seconds; negative if the capture is not complete and right.
double duration_s(const Mode& mode, int lag_refreshes, microseconds transfer) {
  rig::RigFile rig_file = mode.sync == rig::SyncMode::kTriggerBox
                              ? capture::ledger_rig_file()
                              : capture::boxless_rig_file(mode.sync);
  rig_file.sequence.pace = mode.pace;
  rig_file.sequence.exposures = {microseconds(16'667), microseconds(66'667)};
  hw_sim::CameraTiming timing;
  timing.transfer = transfer;
  capture::LedgerCapture capture({}, rig_file, timing, {.input_lag_refreshes = lag_refreshes});
  const rig::HostTime start = capture.rig.timeline().now();
  const capture::RunResult result = capture.run();
  const bool is_right = result.outcome == capture::Outcome::kComplete &&
                        capture.keeper.frames.size() == 176 && capture.wrong_frame_count() == 0 &&
                        result.retake_count == 0;
  const double taken_s = duration<double>(capture.rig.timeline().now() - start).count();
  return is_right ? taken_s : -taken_s;
}

}  // namespace

int main() {
  const Mode modes[] = {
      {"trigger_box, handshake", rig::SyncMode::kTriggerBox, rig::Pace::kHandshake},
      {"trigger_box, paced", rig::SyncMode::kTriggerBox, rig::Pace::kPaced},
      {"camera_line, handshake", rig::SyncMode::kCameraLine, rig::Pace::kHandshake},
      {"camera_line, paced", rig::SyncMode::kCameraLine, rig::Pace::kPaced},
      {"software", rig::SyncMode::kSoftware, rig::Pace::kHandshake},
  };
  std::printf(
      "| sync mode, pace | lag 1, link 3 ms | lag 2, 34 ms | lag 3, 34 ms | lag 3, 68 ms |\n"
      "|---|---|---|---|---|\n");
  int wrong_count = 0;
  for (const Mode& mode : modes) {
    std::printf("| %s |", mode.name);
    for (const auto& [lag_refreshes, transfer_us] :
         {std::pair(1, 3000), std::pair(2, 34'000), std::pair(3, 34'000), std::pair(3, 68'000)}) {
      const double taken_s = duration_s(mode, lag_refreshes, microseconds(transfer_us));
      if (taken_s < 0) ++wrong_count;
      std::printf(" %.2f s |", taken_s);
    }
    std::printf("\n");
  }
  return wrong_count == 0 ? 0 : 1;
}
