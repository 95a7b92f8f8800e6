// Has the subject held still and the light stayed as it was? Said of a whole capture, from the
// repeats of its first pattern, by what such changes cost in the maps; and from what changed for a
// few patterns between them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "estimation/motion/brief_change.h"
#include "estimation/motion/frame_change.h"
#include "estimation/motion/motion_scale.h"
#include "estimation/motion/surface_motion.h"

namespace estimation {

enum class MotionVerdict { kUnknown, kGood, kUsable, kRetake };
std::string to_string(MotionVerdict verdict);

// One repeat against the first showing.
struct Repeat {
  double elapsed_s = 0;  // from the first showing
  std::optional<FrameChange> change;
  std::string objection;                    // why there is no change to tell, where there is none
  std::optional<SurfaceMotion> by_surface;  // once there is a surface to tell it by
};

// How much is good, and how much is still usable. Costs are those of estimation.md section 4.
struct MotionLimits {
  double good = 0, usable = 0;
};
struct MotionRules {
  // Drift of the stripes over the capture, projector px. In order, 0.5 px cost 10% of l_d and 17%
  // of sigma_a; a fifth of it what noise does. Shuffled, 0.5 px cost below 1%; drift spread evenly
  // over the shifts blurs by its length / sqrt(12), and blur of 1 px costs 14%, growing with its
  // square: 2 px of drift cost 5%.
  MotionLimits stripes_in_order_px{.good = 0.1, .usable = 0.5};
  MotionLimits stripes_shuffled_px{.good = 0.5, .usable = 2.0};
  // Along the stripes the skin moves under its own picture: a map's px, and four of them.
  MotionLimits along_px{.good = 1, .usable = 4};
  // 1% of irradiance costs 1% of l_d and 2.7% of sigma_a. Ambient light is as many photons.
  MotionLimits light_frac{.good = 0.01, .usable = 0.04};
  bool is_shuffled = false;
};

// What a repeat's change is in the projector's picture and in mm; absolute values.
struct Motion {
  double stripes_px = 0, stripes_sd_px = 0;  // projector px, rms over the lit part
  double along_px = 0, along_sd_px = 0;      // frame px, of the whole
  // Of the head: by the surface, or else at the calibrated distance, stripes taken for depth.
  std::optional<double> mm, sd_mm;
};
// Of a repeat that has a change.
Motion motion_of(const Repeat& repeat, const MotionScale& scale);

struct MotionReport {
  MotionVerdict verdict = MotionVerdict::kUnknown;
  std::vector<std::string> reasons;  // one clause each, with the numbers; none where all is good
  std::vector<Repeat> repeats;       // in the order of their showing
  std::vector<std::optional<Motion>> motions;  // of each
  std::vector<BriefChange> brief_changes;      // in the order of their showing
  std::string text;  // one sentence: verdict, largest motion and change of light
};

// A brief change, however large, spoils a few patterns of many, and where it was: usable.
MotionReport judge_motion(std::vector<Repeat> repeats, const MotionScale& scale,
                          const MotionRules& rules, std::vector<BriefChange> brief_changes = {});

}  // namespace estimation
