// What the motion watch found, as a file of the session: report/motion.json.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>

#include "estimation/motion/motion_verdict.h"
#include "estimation/session/error.h"

namespace capture {

// What was found, and how.
struct WatchedMotion {
  estimation::MotionReport report;
  int pattern = 0;                           // that was repeated
  std::chrono::nanoseconds verdict_time{0};  // from the last frame's arrival to the verdict
};

// A JSON object: verdict and when it was told, reasons, text and, for each repeat, when it was and
// what had changed.
std::string format_motion(const WatchedMotion& motion);

// Writes SESSION/report/motion.json, whole or not at all. Errors: kUnwritable.
estimation::Result<void> write_motion(const std::filesystem::path& session,
                                      const WatchedMotion& motion);

}  // namespace capture
