// What real optics, rooms and people do to a capture, as numbers; by default nothing.
#pragma once

#include <filesystem>
#include <string_view>

#include "estimation/base/linear.h"
#include "rig/fault.h"

namespace hw_sim {

struct Effects {
  // Projector. Blur is a Gaussian's standard deviation in projector px; what is out of focus adds
  // in quadrature.
  double blur_px = 0;
  double focus_mm = 1000;  // from the projector
  double defocus_px_per_mm = 0;
  double black_frac = 0;       // light of a black pixel, relative to white over black
  double vignetting_frac = 0;  // lost in the picture's corners, as the square of the radius
  // Camera: lost in the picture's corners, as the square of the radius.
  double camera_vignetting_frac = 0;
  // Room: light on the subject, relative to the projector's white at the reference distance, and
  // the share of it that flickers at twice the mains frequency.
  double ambient_frac = 0;
  double flicker_frac = 0;
  double mains_hz = 50;
  // Subject: drift in camera coordinates (x right, y down, z away). Its surface is taken for its
  // tangent plane: light moves over it, its materials stay.
  estimation::Vec3 drift_mm_per_s{0, 0, 0};

  bool operator==(const Effects&) const = default;
  double blur_at(double distance_mm) const;  // px
  bool blurs() const { return blur_px > 0 || defocus_px_per_mm > 0; }
  bool drifts() const { return drift_mm_per_s != estimation::Vec3(0, 0, 0); }
};

// A TOML file with the members as keys in [projector], [camera], [room] and [subject]. Errors:
// kConfiguration naming the file, the key and what was expected.
rig::Result<Effects> read_effects(const std::filesystem::path& file);
rig::Result<Effects> parse_effects(std::string_view toml, const std::filesystem::path& file);

}  // namespace hw_sim
