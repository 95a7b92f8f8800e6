#include "estimation/calibration/light_check.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace estimation {
namespace {

enum class Drive { kBlack, kGrey, kWhite };

Drive drive_of(const LightPair& pair) {
  if (pair.drive_frac <= 0) return Drive::kBlack;
  return pair.drive_frac >= 1 ? Drive::kWhite : Drive::kGrey;
}

const char* name(Drive drive) {
  return drive == Drive::kBlack ? "black" : (drive == Drive::kWhite ? "white" : "grey");
}

std::string percent(double frac) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f%%", 100 * frac);
  return text;
}

struct Level {
  Measured rate;
  double change = 0;  // rms from a pair's first to its second, over white, over sqrt 2
  int count = 0;
};

Level level_of(std::span<const LightPair> pairs, Drive drive) {
  Level level;
  double within = 0;
  for (const LightPair& pair : pairs) {
    if (drive_of(pair) != drive) continue;
    level.rate.value += pair.rate_dn_per_us;
    within += pair.change_frac * pair.change_frac / 2;
    ++level.count;
  }
  if (level.count == 0) return level;
  level.rate.value /= level.count;
  double squares = 0;
  for (const LightPair& pair : pairs)
    if (drive_of(pair) == drive) squares += std::pow(pair.rate_dn_per_us - level.rate.value, 2);
  level.rate.sd = std::sqrt(squares / std::max(1, level.count - 1) / level.count);
  level.change = std::sqrt(within / level.count);
  return level;
}

// ln rate over ln drive, by least squares through white.
Measured fit_gamma(std::span<const LightPair> pairs, double black, double white) {
  double xx = 0, xy = 0, squares = 0;
  int count = 0;
  const auto for_each = [&](const auto& use) {
    for (const LightPair& pair : pairs) {
      if (drive_of(pair) != Drive::kGrey || !(pair.rate_dn_per_us > black)) continue;
      use(std::log(pair.drive_frac), std::log((pair.rate_dn_per_us - black) / (white - black)));
    }
  };
  for_each([&](double x, double y) {
    xx += x * x;
    xy += x * y;
    ++count;
  });
  if (count == 0) return {};
  const double gamma = xy / xx;
  for_each([&](double x, double y) { squares += std::pow(y - gamma * x, 2); });
  return {gamma, std::sqrt(squares / std::max(1, count - 1) / xx)};
}

}  // namespace

LightCheck check_light(std::span<const LightPair> pairs, const LightLimits& limits) {
  LightCheck check;
  const Level white = level_of(pairs, Drive::kWhite), black = level_of(pairs, Drive::kBlack);
  for (const auto& [level, what] : {std::pair(&white, "white"), std::pair(&black, "black")})
    if (level->count == 0) {
      std::string text = "no repeated ";
      check.warnings.push_back(text.append(what).append(
          " frames of one exposure: whether the light is steady was not measured"));
    }
  check.white_dn_per_us = white.rate;
  check.black_dn_per_us = black.rate;
  const auto change_of = [&](const Level& level) {
    const double drift = level.rate.sd * std::sqrt(level.count) / white.rate.value;
    return white.count > 0 ? std::max(level.change, drift) : level.change;
  };
  check.white_change_frac = change_of(white);
  check.black_change_frac = change_of(black);
  for (const auto& [change, what] :
       {std::pair(check.white_change_frac, "white"), std::pair(check.black_change_frac, "black")})
    if (change > limits.change_frac) {
      std::string text = "the projector's ";
      text.append(what).append(" is not steady: repeats differ by ");
      text.append(percent(change)).append(" of white; expected at most ");
      text.append(percent(limits.change_frac));
      check.warnings.push_back(
          text.append(". Let the lamp warm up, and expose for whole refreshes of the projector"));
    }
  bool is_told[3] = {};
  for (const LightPair& pair : pairs) {
    const Drive drive = drive_of(pair);
    if (!(pair.expected_frac > 0) || is_told[static_cast<int>(drive)] ||
        pair.scatter_frac < limits.scatter_ratio * pair.expected_frac)
      continue;
    is_told[static_cast<int>(drive)] = true;
    std::string text = "pixels of a ";
    text.append(name(drive)).append(" picture differ between repeats by ");
    text.append(percent(pair.scatter_frac)).append(", of which the camera's noise explains ");
    text.append(percent(pair.expected_frac));
    text.append(drive == Drive::kGrey
                    ? ": the projector dithers its greys; do not use fringes or greys with it"
                    : ": the light flickers from pixel to pixel");
    check.warnings.push_back(text);
  }
  if (white.count > 0 && white.rate.value > black.rate.value)
    check.gamma = fit_gamma(pairs, black.rate.value, white.rate.value);
  return check;
}

}  // namespace estimation
