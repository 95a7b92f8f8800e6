// What bends and slopes of a scattering surface do to the stripes' phase. Light leaves skin
// millimetres from where it entered; where the surface bends away, or turns from the projector,
// more of what a pixel sees has entered on one side of it, and its stripes seem to lie there: by a
// quarter of a projector px on a face. To first order in the bend it needs no model of the skin:
// the stripes' own harmonics say how far its light spreads.
#pragma once

#include <span>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/surface.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Whose phase the coordinate is: higher harmonics are moved less.
enum class PhaseSource {
  kFirstHarmonic,  // as decode_correspondence reads it
  kAllHarmonics    // as a fit of the whole profile finds it
};

struct BendOptions {
  PhaseSource source = PhaseSource::kFirstHarmonic;
  FrameLevels levels = {};  // where frames are given
  // Bends are those of the surface averaged over this radius, about a diffuse mean free path. On
  // two simulated faces 1.6 mm leaves 0.034 and 0.029 px rms, 2.2 mm 0.032 and 0.028, 3.2 mm 0.033
  // and 0.029; nothing done 0.091 and 0.068.
  double radius_mm = 2.2;
  // The bends of a surface that is not yet in its place are not quite its own.
  int pass_count = 2;
  // Of a shift, how much may be wrong with it: enters the standard deviation. Measured on the same
  // faces.
  double relative_sd = 0.3;
};

// The surface from the correspondence; where a sweep of stripes tells how far light spreads (three
// of its harmonics must be there), the surface around is known and the data show the effect (the
// first two harmonics are moved differently), the shift is first taken out of
// `correspondence`, whose standard deviations grow by its uncertainty.
//   signals  as decode_correspondence took them; the stripes suffice
// Runs in the caller's oneTBB arena; the same bits for any number of threads.
Surface reconstruct_bent_surface(std::span<const PatternSignal> signals,
                                 const Calibration& calibration, const CameraInfo& camera,
                                 const ProjectorInfo& projector, const SurfaceOptions& options,
                                 const BendOptions& bend_options, Correspondence& correspondence);

}  // namespace estimation
