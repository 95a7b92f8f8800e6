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
  double pixel_fill_frac = 1;   // side of the square that a pixel lights, of the pixels' pitch
  double gamma = 1;             // light = grey^gamma: black and white stay what they are
  double black_frac = 0;        // light of a black pixel, relative to white over black
  double vignetting_frac = 0;   // lost in the picture's corners, as the square of the radius
  double crosstalk_frac = 0;    // of a camera band's light that is each other band's
  int input_lag_refreshes = 0;  // beyond the device's own
  double scanout_ms = 0;        // from the light of a picture's first row to that of its last
  double ripple_frac = 0;       // a colour wheel's: light = 1 + ripple sin(), bands a third apart
  double ripple_hz = 180;
  // Camera.
  double camera_blur_px = 0;  // Gaussian, in camera px; out of focus as the projector's
  double camera_focus_mm = 1000;
  double camera_defocus_px_per_mm = 0;
  double camera_vignetting_frac = 0;  // lost in the picture's corners, as the square of the radius
  double full_well_e = 0;             // electrons a pixel holds; 0: more than the converter counts
  double pixel_gain_sd_frac = 0;      // fixed pattern: standard deviation over the pixels
  double pixel_offset_sd_dn = 0;
  double hot_pixel_frac = 0;       // of the pixels
  double hot_pixel_dn_per_s = 0;   // their mean; exponentially distributed
  bool is_cross_polarised = true;  // false: the shine of the skin's surface is seen
  // Room: light on the subject, relative to the projector's white at the reference distance, and
  // the share of it that flickers at twice the mains frequency; a wall behind the subject.
  double ambient_frac = 0;
  double flicker_frac = 0;
  double mains_hz = 50;
  double backdrop_reflectance_frac = 0;
  double backdrop_mm = 1500;  // from the camera, across its axis
  // Subject: motion in camera coordinates (x right, y down, z away). Its surface is taken for its
  // tangent plane: light moves over it, its materials stay. Times are from the first exposure.
  estimation::Vec3 drift_mm_per_s{0, 0, 0};
  estimation::Vec3 breathing_mm{0, 0, 0};  // amplitude of a sine
  double breathing_hz = 0.25;
  double blink_start_s = 0;  // the eyes are open for `blink_s`; again every `blink_period_s`
  double blink_s = 0;
  double blink_period_s = 0;          // 0: once
  double skin_roughness_frac = 0.35;  // of its surface: GGX's alpha

  bool operator==(const Effects&) const = default;
  double blur_at(double distance_mm) const;         // projector px
  double camera_blur_at(double distance_mm) const;  // camera px
  bool blurs() const { return blur_px > 0 || defocus_px_per_mm > 0; }
  bool camera_blurs() const { return camera_blur_px > 0 || camera_defocus_px_per_mm > 0; }
  bool drifts() const;  // moves in any way
  estimation::Vec3 displacement_mm(double elapsed_s) const;
  // Share of [begin, end] with open eyes.
  double blink_frac(double begin_s, double end_s) const;
};

// A TOML file with the members as keys in [projector], [camera], [room] and [subject]. Errors:
// kConfiguration naming the file, the key and what was expected.
rig::Result<Effects> read_effects(const std::filesystem::path& file);
rig::Result<Effects> parse_effects(std::string_view toml, const std::filesystem::path& file);

}  // namespace hw_sim
