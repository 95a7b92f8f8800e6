// What an operator holds in front of the rig to calibrate it: flat targets, each in its place, and
// in which order. Scenes of ssrig-sim beside those of scene.h.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "estimation/base/linear.h"
#include "rig/fault.h"

namespace hw_sim {

// A share of the light that leaves a target spread about where it came in: a Gaussian of this
// standard deviation along either axis. (A measured profile is a sum of a few.)
struct Spread {
  double share_frac = 0;
  double sd_mm = 0;
};

// A flat, matte rectangle; or a cap on the lens.
struct Target {
  enum class Kind { kCap, kCheckerboard, kEven };

  std::string name;
  Kind kind = Kind::kEven;
  double width_mm = 0, height_mm = 0;  // along its own x and y
  estimation::Vec3 middle_mm;          // camera coordinates
  // From facing the camera: about its own y after about its own x after about its own z.
  double tilt_x_deg = 0, tilt_y_deg = 0, spin_deg = 0;
  double reflectance = 0.99;  // of the paper, where it is a checkerboard
  // Of a checkerboard, which lies in the middle of a white border.
  int row_count = 0, col_count = 0;
  double square_mm = 0;
  double ink_reflectance = 0.04;
  std::vector<Spread> spreads;  // of what is lit; the rest leaves where it came in. Empty: opaque

  bool is_there() const { return kind != Kind::kCap; }
  // Own coordinates from the middle (x along columns, y along rows) to camera coordinates.
  estimation::Mat3 rotation() const;
  // At a point of its plane; 0 beside it.
  double reflectance_at(double x_mm, double y_mm) const;
};

// One target a capture, in this order; the last one stays.
struct TargetScene {
  std::vector<Target> steps;
};

// board: a checkerboard of 10 x 13 squares of 15 mm in 15 poses. standard: the lens capped, then a
// reflectance standard (0.99) twice in one place (for the exposures, and for the patterns), then an
// opaque target (0.8) at three distances. translucent: the same, but in the opaque target's place
// stands a plastic one, in which light goes a millimetre or two. Errors: kConfiguration with the
// list of names.
rig::Result<TargetScene> make_target_scene(std::string_view name);
std::vector<std::string> target_scene_names();

}  // namespace hw_sim
