// What the motion watch found, as a file of the session: report/motion.json.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

#include "estimation/motion/motion_verdict.h"
#include "estimation/motion/picture_identity.h"
#include "estimation/session/error.h"

namespace capture {

// Whether the frames show their patterns.
struct WatchedPictures {
  estimation::PictureCheck check;                 // at the end
  std::vector<estimation::WrongPicture> retaken;  // that did not, and were taken again
};

// What was found, and how.
struct WatchedMotion {
  estimation::MotionReport report;
  int pattern = 0;                           // that was repeated
  std::chrono::nanoseconds verdict_time{0};  // from the last frame's arrival to the verdict
  WatchedPictures pictures{};
};

// A JSON object: verdict and when it was told, reasons, text and, for each repeat, when it was and
// what had changed; and which frames do not show their pattern, or could not be checked.
std::string format_motion(const WatchedMotion& motion);

// Writes SESSION/report/motion.json, whole or not at all. Errors: kUnwritable.
estimation::Result<void> write_motion(const std::filesystem::path& session,
                                      const WatchedMotion& motion);

}  // namespace capture
