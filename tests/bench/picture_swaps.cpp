#include "tests/bench/picture_swaps.h"

#include <algorithm>
#include <cmath>
#include <optional>

namespace bench {

using estimation::PictureCheck;
using estimation::SeenPicture;

namespace {

// Of the same bracket, the last before it.
const SeenPicture* shown_before(const std::vector<SeenPicture>& pictures,
                                const SeenPicture& picture) {
  const SeenPicture* before = nullptr;
  for (const SeenPicture& each : pictures)
    if (each.bracket == picture.bracket && each.elapsed_s < picture.elapsed_s &&
        (before == nullptr || each.elapsed_s > before->elapsed_s))
      before = &each;
  return before;
}

void mix(const SeenPicture* other, double black_dn, double share_frac, SeenPicture& picture) {
  for (std::size_t i = 0; i < picture.samples_dn.size(); ++i) {
    const double light = other == nullptr ? black_dn : other->samples_dn[i];
    picture.samples_dn[i] = static_cast<std::uint16_t>(
        std::lround((1 - share_frac) * picture.samples_dn[i] + share_frac * light));
  }
}

}  // namespace

SwapTally try_swaps(const estimation::CameraInfo& camera,
                    const std::vector<estimation::Pattern>& patterns,
                    const std::vector<SeenPicture>& pictures, double share_frac) {
  SwapTally tally;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (!pictures[i].is_of_session) continue;
    ++tally.slot_count;
    std::vector<SeenPicture> swapped = pictures;
    const SeenPicture* before = shown_before(pictures, pictures[i]);
    mix(before, camera.black_level_dn.value_or(0), share_frac, swapped[i]);
    const PictureCheck check = check_pictures(camera, patterns, swapped);
    const auto is_this = [&](const auto& each) {
      return each.pattern == pictures[i].pattern && each.bracket == pictures[i].bracket;
    };
    const bool is_found = std::any_of(check.wrong.begin(), check.wrong.end(), is_this);
    const bool is_unchecked = std::any_of(check.unchecked.begin(), check.unchecked.end(), is_this);
    tally.checked_count += is_unchecked ? 0 : 1;
    tally.found_count += is_found ? 1 : 0;
    tally.alone_count += is_found && check.wrong.size() == 1 ? 1 : 0;
    tally.undetected_count += check.wrong.empty() ? 1 : 0;
    if (!is_found)
      tally.missed.push_back(
          "pattern " + std::to_string(pictures[i].pattern) + " bracket " +
          std::to_string(pictures[i].bracket) + (is_unchecked ? " (unchecked)" : "") +
          " before: " + (before == nullptr ? "black" : std::to_string(before->pattern)) +
          "; said: " + check.text());
  }
  return tally;
}

}  // namespace bench
