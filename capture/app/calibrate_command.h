// The parts of `ssrig calibrate`, one file each.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "capture/app/commands.h"
#include "capture/calibrate/geometry_job.h"
#include "capture/calibrate/radiometry_job.h"
#include "capture/exit_code.h"
#include "rig/rig_file.h"

namespace capture {

struct GeometryArguments {
  std::string rig_file;
  std::vector<std::string> board;  // kind, ROWSxCOLS, the square's edge in mm
  std::vector<std::string> sessions;
  std::string out;  // empty: the rig file's calibration
};

// Shows the patterns on the board, pose after pose, until the operator is content: says before each
// which pose is missing, and after it what is known. The sessions stay in the rig's storage folder.
ExitCode capture_poses(const rig::RigFile& rig_file, GeometryJob& job);

// Captures the radiometric series step by step, saying before each what to hold where, judging each
// when it is there; the sessions that will do are added to `inputs` and stay in the rig's storage
// folder.
ExitCode capture_series(const rig::RigFile& rig_file, const estimation::Calibration& geometry,
                        RadiometryInputs& inputs);

// `ssrig calibrate radiometry`, below `calibrate`.
void add_calibrate_radiometry_command(CLI::App& calibrate, const Select& select);

// "calibration.json" -> "calibration.PART.20260131-142501", a folder beside it.
std::filesystem::path report_folder(const std::filesystem::path& calibration, const char* part,
                                    std::chrono::system_clock::time_point now);

}  // namespace capture
