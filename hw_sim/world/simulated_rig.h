// A rig file's camera, projector and calibration as a world takes them.
#pragma once

#include "estimation/session/manifest.h"
#include "rig/fault.h"
#include "rig/rig_file.h"

namespace hw_sim {

struct SimulatedRig {
  estimation::CameraInfo camera;
  estimation::ProjectorInfo projector;
  estimation::Calibration calibration;
};

// Errors: kConfiguration for a pixel format that is not simulated, or a calibration file that is
// not named, not there or not one.
rig::Result<SimulatedRig> simulated_rig(const rig::RigFile& rig);

}  // namespace hw_sim
