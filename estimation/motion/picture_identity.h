// Does each frame show its pattern? Without calibration, geometry or knowledge of the scene: the
// frames of a session must fit each other. Shifted stripes make each place's light a smooth
// function of the shift, so each frame tells which shift it shows; Gray code and its inverse, and
// stripes and their complement, add up to one and the same light everywhere. Independent of all
// evidence by time. Pure: arrays in, findings out.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "estimation/session/manifest.h"
#include "estimation/session/pattern.h"

namespace estimation {

struct SeenPicture {
  int pattern = 0;  // its index in the session
  int bracket = 0;
  double elapsed_s = 0;                   // tells the order of showing, and how far apart
  bool is_of_session = true;              // else a repeat: only what was shown beside others
  std::vector<std::uint16_t> samples_dn;  // by PictureSampler
};

// A frame that does not show its pattern.
struct WrongPicture {
  int pattern = 0;
  int bracket = 0;
  double share_frac = 0;            // of its light that is not its pattern's, at least
  std::optional<int> seen_pattern;  // that it shows in place of it, or mixed with it
  std::optional<int> or_pattern;    // either this one is wrong or that one, and both are named
};

struct UncheckedPicture {
  int pattern = 0;
  int bracket = 0;
  std::string why;
};

struct PictureCheck {
  std::vector<WrongPicture> wrong;          // by pattern and bracket
  std::vector<UncheckedPicture> unchecked;  // likewise
  int checked_count = 0;                    // frames that were judged, right or wrong
  std::vector<double> wrong_repeats_s;      // elapsed_s of repeats in a run of wrong pictures
  std::string text() const;                 // one sentence
};

// Finds frames in which another picture of the session, shown before or after them, or black has
// at least a quarter of the light, in the whole frame. What happens in a part of it (a blink), what
// comes in beside the projector's light (a flash), what moves steadily, and noise raise nothing.
// And runs of frames that all show the picture before or after their own, which among themselves
// are as regular as right ones; in a sweep that is shown in the order of its shifts they are not
// told from a motion.
// Checked are stripes or fringes of at least 16 shifts, Gray code with its inverse, stripes with
// their complement and white with black; of those pairs at least two must be there.
PictureCheck check_pictures(const CameraInfo& camera, const std::vector<Pattern>& patterns,
                            const std::vector<SeenPicture>& pictures);

}  // namespace estimation
