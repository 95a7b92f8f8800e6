// The live radiometric series, step by step: what the operator holds before the rig, what is
// captured of it, and whether that will do.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "capture/calibrate/radiometry_job.h"
#include "capture/plan.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "rig/rig_file.h"

namespace capture {

struct RadiometryStep {
  std::string subject;  // of the session: "calibration-dark"
  std::string words;    // what to do first, for people
  Plan plan;
  std::vector<std::string> RadiometryInputs::*sessions = nullptr;  // where its session belongs
};

// Dark frames, exposures of a steady scene, the standard, an opaque target at three distances.
std::vector<RadiometryStep> radiometry_steps(const rig::RigFile& rig_file);

// Is this session what the step asked for? `before` are the sessions accepted so far (the exposures
// are judged by the dark frames). Returns what it warns of. Errors: why it will not do, and what to
// do; then capture the step again.
estimation::Result<std::vector<std::string>> check_step(const RadiometryStep& step,
                                                        const std::filesystem::path& session,
                                                        const RadiometryInputs& before,
                                                        const estimation::Calibration& geometry);

}  // namespace capture
