// A session of a calibration target: how bright it is under white and black, where it lies.
#pragma once

#include <filesystem>

#include "capture/calibrate/session_signals.h"
#include "estimation/base/image.h"
#include "estimation/calibration/illumination_fit.h"
#include "estimation/calibration/transfer_fit.h"
#include "estimation/geometry/surface.h"

namespace capture {

struct LitScene {
  SessionSignals read;
  // [height][width][channel] DN/us: white over black, and black (ambient and projector black; empty
  // where the patterns do not tell it).
  estimation::Image<float> white, black;
  estimation::Correspondence correspondence;
  estimation::Surface surface;

  estimation::StandardView standard_view() const;
};

// `calibration` has the rig's geometry. White and black come from patterns of that name; else from
// Gray code and its inverse (white + black) and the mean of the stripes. Errors: files;
// kInsufficient where neither is there, or the patterns do not tell where the light falls.
estimation::Result<LitScene> read_lit_scene(const std::filesystem::path& session,
                                            const estimation::Calibration& calibration);

// The stripes' sweep of such a scene, black subtracted in place. Borrows from `scene`. Errors:
// kInsufficient without stripes of period 40.
estimation::Result<estimation::TransferSweep> transfer_sweep(LitScene& scene);

}  // namespace capture
