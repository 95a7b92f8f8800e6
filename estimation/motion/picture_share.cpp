#include "estimation/motion/picture_share.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <iterator>

#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

constexpr double kLeastContrast = 0.1;  // of the light: less, and two pictures look the same
// Of the light: what makes all places brighter, or all darker, by less may be lamp or room.
constexpr double kLeastOneSided = 0.1;
constexpr double kFewestFrac = 0.005;  // of the places
constexpr double kFewestQuietFrac = 0.1;
constexpr double kMostQuiet = 0.3;  // of the share: what places that cannot change may show
constexpr double kLeastWhole = 0.85, kMostWhole = 1.15;
constexpr double kMostUnexplained = 0.1;  // of the surplus' square
constexpr double kWholeContrast = 0.3;

// Of a surplus over places where the change would be more, less, or nothing.
struct Sums {
  std::size_t more_count = 0, less_count = 0, quiet_count = 0;
  double more_product = 0, less_product = 0;   // surplus times change
  double more_square = 0, less_square = 0;     // of the change
  double quiet_product = 0, quiet_square = 0;  // surplus times light; of the light
  double surplus_square = 0, change_square = 0, light_square = 0;
};

// `surplus` = seen less expected, `change` = the other picture less expected; `light` white +
// black.
Sums sum_up(const PlaceLight& surplus, const PlaceLight& change, const PlaceLight& light,
            float bound) {
  Sums sums;
  constexpr std::size_t kRun = 512;
  for (std::size_t begin = 0; begin < surplus.size(); begin += kRun) {
    const std::size_t end = std::min(begin + kRun, surplus.size());
    std::array<float, 11> part{};
    for (std::size_t i = begin; i < end; ++i) {
      const float limit = bound * light[i];
      const float more = change[i] > limit ? 1.0F : 0.0F, less = change[i] < -limit ? 1.0F : 0.0F;
      const float quiet = std::abs(change[i]) < 0.5F * limit ? 1.0F : 0.0F;
      const float product = surplus[i] * change[i], square = change[i] * change[i];
      part[0] += more;
      part[1] += less;
      part[2] += quiet;
      part[3] += more * product;
      part[4] += less * product;
      part[5] += more * square;
      part[6] += less * square;
      part[7] += quiet * surplus[i] * light[i];
      part[8] += quiet * light[i] * light[i];
      part[9] += surplus[i] * surplus[i];
      part[10] += square;
    }
    sums.more_count += static_cast<std::size_t>(part[0]);
    sums.less_count += static_cast<std::size_t>(part[1]);
    sums.quiet_count += static_cast<std::size_t>(part[2]);
    double* const into[] = {&sums.more_product,   &sums.less_product,  &sums.more_square,
                            &sums.less_square,    &sums.quiet_product, &sums.quiet_square,
                            &sums.surplus_square, &sums.change_square};
    for (std::size_t k = 0; k < std::size(into); ++k) *into[k] += static_cast<double>(part[k + 3]);
  }
  return sums;
}

}  // namespace

PictureShare share_of(const PlaceLight& surplus, const PlaceLight& change,
                      const PlaceLight& light) {
  double square = 0, light_square = 0;
  for (std::size_t i = 0; i < change.size(); ++i) {
    square += static_cast<double>(change[i] * change[i]);
    light_square += static_cast<double>(light[i] * light[i]);
  }
  const double contrast = std::sqrt(square / light_square);
  if (!(contrast > kLeastContrast)) return {};
  const Sums sums = sum_up(surplus, change, light, static_cast<float>(0.5 * contrast));
  const double product = sums.more_product + sums.less_product;
  const double all_square = sums.more_square + sums.less_square;
  PictureShare share{0, 0, sums.surplus_square, square, true};
  if (!(all_square > 0)) return share;
  const double frac = product / all_square;
  const double sd = std::sqrt(std::max(sums.surplus_square - frac * frac * all_square, 0.0) /
                              static_cast<double>(surplus.size()) / all_square * 2);
  const auto enough = [&surplus](std::size_t count, double of) {
    return static_cast<double>(count) >= of * static_cast<double>(surplus.size());
  };
  if (enough(sums.more_count, kFewestFrac) && enough(sums.less_count, kFewestFrac)) {
    share.frac =
        std::min(sums.more_product / sums.more_square, sums.less_product / sums.less_square);
  } else if (enough(sums.quiet_count, kFewestQuietFrac)) {
    const double quiet = sums.quiet_product / sums.quiet_square / contrast;
    if (std::abs(quiet) < kMostQuiet * std::abs(frac)) share.frac = frac;
  } else if (contrast > kWholeContrast && frac > kLeastWhole && frac < kMostWhole &&
             sums.surplus_square - frac * product < kMostUnexplained * sums.surplus_square) {
    share.frac = frac;
  }
  const bool is_two_sided =
      enough(sums.more_count, kFewestFrac) && enough(sums.less_count, kFewestFrac);
  if (!is_two_sided && share.frac * contrast < kLeastOneSided) share.frac = 0;
  if (share.frac < kSureOfPicture * sd) share.frac = 0;
  share.explained = frac * product;
  return share;
}

}  // namespace estimation
