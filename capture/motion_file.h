// What the motion watch found, as a file of the session: report/motion.json.
#pragma once

#include <filesystem>
#include <string>

#include "estimation/motion/motion_verdict.h"
#include "estimation/session/error.h"

namespace capture {

// A JSON object: verdict, reasons, text and, for each repeat, when it was and what had changed.
std::string format_motion(const estimation::MotionReport& report, int pattern);

// Writes SESSION/report/motion.json, whole or not at all. Errors: kUnwritable.
estimation::Result<void> write_motion(const std::filesystem::path& session,
                                      const estimation::MotionReport& report, int pattern);

}  // namespace capture
