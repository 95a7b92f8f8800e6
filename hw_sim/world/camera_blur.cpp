#include "hw_sim/world/camera_blur.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace hw_sim {

namespace {

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

constexpr double kStep_px = 0.1;  // between the blurs that are computed; linear between

// Contrast of the Gaussian at every frequency that the lattice holds.
std::vector<float> make_taps(double sigma) {
  const int reach = static_cast<int>(std::ceil(4 * sigma)) + 4;
  constexpr int kSteps = 200;
  constexpr double kTurn = 2 * std::numbers::pi;
  std::vector<float> taps;
  for (int i = -reach; i <= reach; ++i) {
    double sum = 0;
    for (int step = 0; step < kSteps; ++step) {
      const double freq = 0.5 * (step + 0.5) / kSteps;
      sum += std::exp(-0.5 * std::pow(kTurn * sigma * freq, 2)) * std::cos(kTurn * freq * i);
    }
    taps.push_back(static_cast<float>(sum / kSteps));
  }
  return taps;
}

}  // namespace

CameraBlur::CameraBlur(estimation::Image<float> blur_px, int pitch_px)
    : blur_px_(std::move(blur_px)), pitch_px_(pitch_px) {
  const auto step_of = [](float each) {
    return static_cast<int>(static_cast<double>(each) / kStep_px);
  };
  const auto [least, greatest] =
      std::minmax_element(blur_px_.samples().begin(), blur_px_.samples().end());
  first_step_ = step_of(*least);
  taps_.resize(to_size(step_of(*greatest) - first_step_) + 2);
  // A wall far out of focus leaves most of the blurs between it and the subject without a pixel.
  for (const float each : blur_px_.samples())
    for (const int step : {step_of(each), step_of(each) + 1}) {
      std::vector<float>& taps = taps_[to_size(step - first_step_)];
      if (taps.empty()) taps = make_taps(step * kStep_px / pitch_px);
    }
}

void CameraBlur::apply(estimation::Image<float>& linear) const {
  if (is_sharp()) return;
  for (int channel = 0; channel < linear.channel_count(); ++channel)
    for (int row = 0; row < pitch_px_; ++row)
      for (int col = 0; col < pitch_px_; ++col) apply_to_lattice(row, col, channel, linear);
}

void CameraBlur::apply_to_lattice(int first_row, int first_col, int channel,
                                  estimation::Image<float>& linear) const {
  const int height = (linear.height_px() - first_row + pitch_px_ - 1) / pitch_px_;
  const int width = (linear.width_px() - first_col + pitch_px_ - 1) / pitch_px_;
  estimation::Image<float> input(height, width), across(height, width), output(height, width);
  const auto pixel = [&](int row, int col) -> float& {
    return linear.at(first_row + row * pitch_px_, first_col + col * pitch_px_, channel);
  };
  for (int row = 0; row < height; ++row)
    for (int col = 0; col < width; ++col) input.at(row, col) = pixel(row, col);
  // Each of the blurs over the whole picture; a pixel takes its part of the two next to its own.
  const auto share = [&](int row, int col, std::size_t level) {
    const double blur_px =
        static_cast<double>(blur_px_.at(first_row + row * pitch_px_, first_col + col * pitch_px_));
    const double position = blur_px / kStep_px - first_step_;
    return static_cast<float>(std::max(0.0, 1 - std::abs(position - static_cast<double>(level))));
  };
  for (std::size_t level = 0; level < taps_.size(); ++level) {
    const std::vector<float>& taps = taps_[level];
    if (taps.empty()) continue;
    const int reach = static_cast<int>(taps.size() / 2);
    tbb::parallel_for(0, height, [&](int row) {
      std::vector<float> padded(to_size(width + 2 * reach));
      for (int i = 0; i < width + 2 * reach; ++i)
        padded[static_cast<std::size_t>(i)] = input.at(row, std::clamp(i - reach, 0, width - 1));
      const auto sums = across.view().row(row);
      std::fill(sums.begin(), sums.end(), 0.0F);
      for (std::size_t i = 0; i < taps.size(); ++i)
        for (std::size_t col = 0; col < sums.size(); ++col)
          sums[col] += taps[i] * padded[col + taps.size() - 1 - i];
    });
    tbb::parallel_for(0, height, [&](int row) {
      std::vector<float> shares(static_cast<std::size_t>(width)), sums(shares.size());
      for (int col = 0; col < width; ++col)
        shares[static_cast<std::size_t>(col)] = share(row, col, level);
      if (std::none_of(shares.begin(), shares.end(), [](float each) { return each > 0; })) return;
      for (int i = -reach; i <= reach; ++i) {
        const float tap = taps[to_size(i + reach)];
        const float* from = &across.at(std::clamp(row + i, 0, height - 1), 0);
        for (std::size_t col = 0; col < sums.size(); ++col) sums[col] += tap * from[col];
      }
      const auto out = output.view().row(row);
      for (std::size_t col = 0; col < sums.size(); ++col) out[col] += shares[col] * sums[col];
    });
  }
  for (int row = 0; row < height; ++row)
    for (int col = 0; col < width; ++col) pixel(row, col) = output.at(row, col);
}

}  // namespace hw_sim
