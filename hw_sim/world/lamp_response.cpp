#include "hw_sim/world/lamp_response.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace hw_sim {

namespace {

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

double sinc(double x) {
  const double turn = std::numbers::pi * x;
  return std::abs(turn) < 1e-9 ? 1 : std::sin(turn) / turn;
}

// Taps whose contrast is a Gaussian's, and the smaller square's over the whole one's, at every
// frequency that pixels hold: transport sums over whole squares already.
std::vector<double> make_taps(double sigma_px, double pixel_fill_frac) {
  if (sigma_px <= 0 && pixel_fill_frac == 1) return {1.0};
  const int reach = static_cast<int>(std::ceil(5 * sigma_px)) + 8;
  constexpr int kSteps = 400;
  constexpr double kTurn = 2 * std::numbers::pi;
  std::vector<double> contrast;
  for (int step = 0; step < kSteps; ++step) {
    const double freq_per_px = 0.5 * (step + 0.5) / kSteps;
    contrast.push_back(std::exp(-0.5 * std::pow(kTurn * sigma_px * freq_per_px, 2)) *
                       sinc(pixel_fill_frac * freq_per_px) / sinc(freq_per_px));
  }
  std::vector<double> taps;
  for (int i = -reach; i <= reach; ++i) {
    double sum = 0;
    for (int step = 0; step < kSteps; ++step)
      sum += contrast[static_cast<std::size_t>(step)] *
             std::cos(kTurn * 0.5 * (step + 0.5) / kSteps * i);
    taps.push_back(sum / kSteps);
  }
  return taps;
}

}  // namespace

LampResponse::LampResponse(double gamma, double pixel_fill_frac, double greatest_blur_px)
    : is_linear_(gamma == 1) {
  for (std::size_t grey = 0; grey < light_of_grey_.size(); ++grey)
    light_of_grey_[grey] =
        static_cast<float>(is_linear_ ? static_cast<double>(grey) / 255
                                      : std::pow(static_cast<double>(grey) / 255, gamma));
  const auto step_px = static_cast<double>(LitLine::kBlurStep_px);
  // One level beyond the greatest: places lie between two levels.
  const int levels = greatest_blur_px > 0 ? static_cast<int>(greatest_blur_px / step_px) + 2 : 1;
  for (int level = 0; level < levels; ++level)
    taps_.push_back(make_taps(level * step_px, pixel_fill_frac));
}

bool LampResponse::is_exact_for(const std::vector<unsigned char>& line) const {
  if (taps_.size() > 1 || taps_.front().size() > 1) return false;
  return is_linear_ || std::all_of(line.begin(), line.end(),
                                   [](unsigned char grey) { return grey == 0 || grey == 255; });
}

LitLine LampResponse::lit(const std::vector<unsigned char>& line) const {
  const int last = static_cast<int>(line.size()) - 1;
  std::vector<std::vector<float>> levels;
  for (const std::vector<double>& taps : taps_) {
    const int reach = static_cast<int>(taps.size() / 2);
    std::vector<float>& level = levels.emplace_back();
    level.reserve(line.size());
    for (int px = 0; px <= last; ++px) {
      double sum = 0;
      for (int i = -reach; i <= reach; ++i)
        sum += taps[to_size(i + reach)] *
               static_cast<double>(light(line[to_size(std::clamp(px - i, 0, last))]));
      level.push_back(static_cast<float>(sum));
    }
  }
  return LitLine(std::move(levels));
}

}  // namespace hw_sim
