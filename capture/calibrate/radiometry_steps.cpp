#include "capture/calibrate/radiometry_steps.h"

#include <cstdio>

#include "capture/calibrate/calibration_plans.h"
#include "capture/calibrate/sensor_series.h"

namespace capture {

using estimation::InputError;
using estimation::InputFault;
using estimation::Result;
namespace fs = std::filesystem;

std::vector<RadiometryStep> radiometry_steps(const rig::RigFile& rig_file) {
  std::vector<RadiometryStep> steps;
  steps.push_back(
      {"calibration-dark", "cap the camera's lens", dark_plan(rig_file), &RadiometryInputs::dark});
  steps.push_back({"calibration-series",
                   "take the cap off and put the reflectance standard, or any even white surface, "
                   "where the subject will be; nothing may move",
                   series_plan(rig_file), &RadiometryInputs::series});
  steps.push_back({"calibration-standard",
                   "put the reflectance standard where the subject will be, facing halfway between "
                   "camera and projector",
                   target_plan(rig_file), &RadiometryInputs::standard});
  const auto opaque = [&](const std::string& where) {
    steps.push_back({"calibration-opaque",
                     "put the opaque target (matt white paint on metal, not the standard) " + where,
                     target_plan(rig_file), &RadiometryInputs::opaque});
  };
  opaque("50 mm nearer than the subject will be");
  opaque("where the subject will be");
  opaque("50 mm farther than the subject will be");
  return steps;
}

Result<std::vector<std::string>> check_step(const RadiometryStep& step, const fs::path& session,
                                            const RadiometryInputs& before,
                                            const estimation::Calibration& geometry) {
  if (step.sessions == &RadiometryInputs::dark) {
    SensorSeries series;
    if (const auto added = series.add_dark(session); !added) return tl::unexpected(added.error());
    if (const auto dark = series.check_dark(); !dark) {
      InputError error = dark.error();
      error.file = session.string();
      return tl::unexpected(error);
    }
    return std::vector<std::string>{};
  }
  RadiometryInputs alone;
  alone.reflectance = before.reflectance;
  (alone.*step.sessions).push_back(session.string());
  if (step.sessions == &RadiometryInputs::series) {
    if (before.dark.empty())
      return tl::unexpected(InputError{InputFault::kInsufficient, session.string(), "",
                                       "exposures tell nothing without dark frames; capture those "
                                       "first"});
    alone.dark = before.dark;
  }
  const auto job = RadiometryJob::run(alone, geometry);
  if (!job) return tl::unexpected(job.error());
  return job->warnings();
}

}  // namespace capture
