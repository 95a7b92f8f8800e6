#include "hw_sim/world/camera_blur.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace hw_sim {

namespace {

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
  const auto [least, greatest] =
      std::minmax_element(blur_px_.samples().begin(), blur_px_.samples().end());
  first_step_ = static_cast<int>(static_cast<double>(*least) / kStep_px);
  const int last_step = static_cast<int>(static_cast<double>(*greatest) / kStep_px) + 1;
  for (int step = first_step_; step <= last_step; ++step)
    taps_.push_back(make_taps(step * kStep_px / pitch_px));
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
  for (std::size_t level = 0; level < taps_.size(); ++level) {
    const std::vector<float>& taps = taps_[level];
    const int reach = static_cast<int>(taps.size() / 2);
    tbb::parallel_for(0, height, [&](int row) {
      for (int col = 0; col < width; ++col) {
        float sum = 0;
        for (int i = -reach; i <= reach; ++i)
          sum += taps[static_cast<std::size_t>(i + reach)] *
                 input.at(row, std::clamp(col + i, 0, width - 1));
        across.at(row, col) = sum;
      }
    });
    tbb::parallel_for(0, height, [&](int row) {
      for (int col = 0; col < width; ++col) {
        const double position = static_cast<double>(blur_px_.at(first_row + row * pitch_px_,
                                                                first_col + col * pitch_px_)) /
                                    kStep_px -
                                first_step_;
        const double share = 1 - std::abs(position - static_cast<double>(level));
        if (!(share > 0)) continue;
        float sum = 0;
        for (int i = -reach; i <= reach; ++i)
          sum += taps[static_cast<std::size_t>(i + reach)] *
                 across.at(std::clamp(row + i, 0, height - 1), col);
        output.at(row, col) += static_cast<float>(share) * sum;
      }
    });
  }
  for (int row = 0; row < height; ++row)
    for (int col = 0; col < width; ++col) pixel(row, col) = output.at(row, col);
}

}  // namespace hw_sim
