// The surface from the correspondence: triangulated, smoothed without crossing edges, with the
// normals, pitches, angles and distances that the profiles' fit needs.
#pragma once

#include <array>
#include <cstdint>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct SurfaceOptions {
  // Radius of the local quadric fit on the surface, mm; 0 leaves positions as triangulated and fits
  // normals in the 3 x 3 neighbourhood. 1.6 mm on a simulated face at 0.53 mm a pixel: normals to
  // 0.27 degrees in the median, 2.9 at the 90th percentile; 0.8 mm 0.83 and 3.0, 2 mm 0.25 and 3.2.
  // Wider where that would leave the normals noisy: Gray code alone, a coarse camera.
  double smoothing_radius_mm = 1.6;
  double max_epipolar_px = 3;  // columns and rows disagree by more: no correspondence
  // Of one pixel before smoothing; more than both: no correspondence. The share of depth is for
  // rigs that look across a room.
  double max_position_sd_mm = 5;
  double max_position_sd_frac = 0.01;
  double max_slope = 4;             // depth per sideways mm, steeper between neighbours is a jump
  double min_cos_projector = 0.17;  // about 80 degrees
  double min_cos_camera = 0.17;
  // What is near a discontinuity and gets less than this share of the light that pixels of its
  // colour get within the radius is lit by their glow, not by the projector: no correspondence. On
  // two simulated faces that takes 89 and 67% of the false positions in cast shadows and 0.02% of
  // the good ones; a dark material away from edges is not meant. 0: not looked for.
  double glow_frac = 0.25;
  double glow_radius_mm = 3;
  double near_discontinuity_mm = 2;  // a jump or the border within this distance is worth a warning
};

// All [height][width] on the frames' grid; NaN where validity holds an error.
struct Surface {
  std::array<Image<float>, 3> position_mm;  // X, Y, Z; camera coordinates
  std::array<Image<float>, 3> normal;       // X, Y, Z; unit, towards the camera
  Image<float> column_pitch_mm;             // mm on the surface per projector column, across it
  Image<float> row_pitch_mm;
  Image<float> cos_projector;  // normal against the direction to the projector
  Image<float> cos_camera;
  Image<float> projector_distance_mm;  // from the projector's centre
  Image<float> position_sd_mm;         // after smoothing, along the camera's ray
  Image<float> tilt_sd_rad;            // of the normal, about any axis across it, by noise
  // Validity: the correspondence's errors, kNoCorrespondence (axes disagree, behind a device, too
  // uncertain, in the sync square), kGrazingProjector, kGrazingCamera; warning kNearDiscontinuity.
  Image<std::uint32_t> validity;
};

// What of a surface is wanted.
enum class SurfaceParts {
  kShape,  // position_mm, normal and validity; the other images stay as they are
  kAll
};

// Uses whichever axes `correspondence` has; at least one. Same result for any number of threads.
// Thread-safe.
Surface reconstruct_surface(const Calibration& calibration, const CameraInfo& camera,
                            const ProjectorInfo& projector, const Correspondence& correspondence,
                            const SurfaceOptions& options);

// The same into `out`, whose memory is used again if it is of the frames' size.
void reconstruct_surface_into(const Calibration& calibration, const CameraInfo& camera,
                              const ProjectorInfo& projector, const Correspondence& correspondence,
                              const SurfaceOptions& options, SurfaceParts parts, Surface& out);

}  // namespace estimation
