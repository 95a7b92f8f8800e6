// The manifest that a capture sets out to fill: everything known before the first frame.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "rig/rig_file.h"

namespace capture {

struct SessionInfo {
  std::string subject;
  std::chrono::system_clock::time_point created;  // from outside: tests have their own
};

// Rig, calibration and patterns, with one frame record per slot, pattern by pattern and bracket by
// bracket, each with the file name it will have. Errors: kInvalid or kNotFound, the rig file's or
// the calibration's.
estimation::Result<estimation::Manifest> plan_manifest(const rig::RigFile& rig_file,
                                                       const Plan& plan, const SessionInfo& info);

// The names of the files that a calibration refers to, relative to itself; a session has copies in
// its folder calibration/.
std::vector<std::string*> auxiliary_files(estimation::Calibration& calibration);

// "20260131-142501-anna": date and time in UTC, and what of the subject can be a file name.
std::string folder_name(const SessionInfo& info);

// What the session will take on disk: frames as they are written, and room for the maps.
std::uintmax_t needed_bytes(const estimation::Manifest& manifest);

// Makes `directory` if it is not there. Errors: kUnwritable, with the remedy: it cannot be written
// to, or has less than `byte_count` free.
estimation::Result<void> check_storage(const std::filesystem::path& directory,
                                       std::uintmax_t byte_count);

}  // namespace capture
