// What the checks of frames against each other share. Private to estimation/motion.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "estimation/motion/picture.h"
#include "estimation/motion/picture_identity.h"
#include "estimation/session/manifest.h"
#include "estimation/session/pattern.h"

namespace estimation {

// The frames of one bracket in the order of their showing.
struct BracketPictures {
  struct Entry {
    const SeenPicture* picture = nullptr;
    const Pattern* pattern = nullptr;
  };
  int bracket = 0;
  std::vector<Entry> shown;
};

// Places that are lit, and clipped in no frame: [frame][place] DN above black.
struct LitTable {
  std::vector<std::size_t> places;
  std::vector<std::vector<float>> light_dn;
};
constexpr std::size_t kFewestPlaces = 200;

// `frames` are positions in BracketPictures::shown.
LitTable make_table(const CameraInfo& camera, const BracketPictures& pictures,
                    const std::vector<std::size_t>& frames);

// [place of `table`] of any frame, DN above black; where it is clipped, the limit.
std::vector<float> light_at(const CameraInfo& camera, const LitTable& table,
                            const SeenPicture& picture);

// What a check of one group of frames found; positions in BracketPictures::shown.
struct GroupFinding {
  std::size_t frame = 0;
  double share_frac = 0;
  std::optional<int> seen_pattern{};
  std::optional<std::size_t> or_frame{};
};
struct GroupCheck {
  std::vector<GroupFinding> wrong;
  std::vector<std::pair<std::size_t, std::string>> unchecked;
  std::vector<std::size_t> wrong_repeats{};
  std::size_t judged_count = 0;
  double speed_px_per_s = 0;  // of the stripes, in the projector's px; stripes alone tell
};

// From this share on a frame does not show its pattern: asked is to find three tenths.
constexpr double kWrongFrac = 0.25;
// Standard deviations that a finding must have.
constexpr double kSureOfPicture = 8;

// Stripes or fringes of one axis, period and width, of 16 shifts or more.
struct ShiftSeries {
  std::vector<std::size_t> frames;  // in the order of their showing
  std::vector<double> phases_rad;   // 2 pi shift / period
  double period_px = 0;
};
GroupCheck check_shifts(const CameraInfo& camera, const BracketPictures& pictures,
                        const ShiftSeries& series);

// Two pictures that add up to white and black.
struct Complement {
  std::size_t first = 0, second = 0;  // in the order of their showing
  double run_px = 0;  // the shortest stretch of light or dark; 0: the picture has none
};
GroupCheck check_complements(const CameraInfo& camera, const BracketPictures& pictures,
                             const std::vector<Complement>& pairs, double speed_px_per_s);

// What a picture is to the others: of a sweep, or one half of pairs.
struct PictureRole {
  struct Half {
    int pair = 0;
    bool is_second = false;
  };
  int series = -1;  // -1: of none
  double phase_rad = 0;
  std::vector<Half> halves{};
};

// Frames [begin, end) show what was shown `offset` pictures after them; 0: there are none.
struct DisplacedRun {
  std::size_t begin = 0, end = 0;  // positions in BracketPictures::shown
  int offset = 0;
};

// `roles` are by position, of repeats as well. Runs of two frames or more, where the frames before
// and after differ enough to tell.
std::optional<DisplacedRun> find_displaced(const CameraInfo& camera,
                                           const BracketPictures& pictures,
                                           const std::vector<PictureRole>& roles);

}  // namespace estimation
