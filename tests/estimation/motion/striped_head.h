// A head under stripes as a formula, to be moved by any fraction of a pixel: frames for the tests
// of estimation/motion, with the sensor's noise.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>
#include <random>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct StripedHead {
  double shift_row_px = 0, shift_col_px = 0;  // of all that is seen
  double stripe_slope = 0;  // stripes move on by so much a px from the middle: a head that turned
  double light = 1;         // of the projector
  double ambient_frac = 0;  // beside it, of the lit level
  double blink_frac = 0;    // an eye's light changes by so much
  bool is_noisy = true;
  std::uint64_t seed = 1;
};

inline CameraInfo striped_camera(int width_px = 196, int height_px = 144) {
  CameraInfo camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  camera.pixel_format = {ColorFilter::kBayerRG, 12};
  camera.black_level_dn = 64;
  camera.saturation_level_dn = 4000;
  camera.gain_e_per_dn = 4.88;
  camera.read_noise_e = 10;
  return camera;
}

inline double period_px(const CameraInfo& camera) { return camera.width_px / 16.0; }

inline constexpr double kLitDn = 1500;
inline constexpr double kEyeRowFrac = 0.38, kEyeColFrac = 0.40;

// DN above black at a point of the frame, mean over the colours.
inline double light_at(const StripedHead& head, const CameraInfo& camera, double row, double col) {
  const double y = (row - head.shift_row_px) / camera.height_px;
  const double x = (col - head.shift_col_px) / camera.width_px;
  const double radius = std::hypot((y - 0.5) / 0.42, (x - 0.5) / 0.33);
  const double inside = 1 / (1 + std::exp((radius - 1) * 40));
  const double texture = 1 + 0.15 * std::sin(23 * x + 11 * y) * std::cos(17 * y - 5 * x);
  const double eye =
      std::exp(-(std::pow((y - kEyeRowFrac) / 0.035, 2) + std::pow((x - kEyeColFrac) / 0.05, 2)));
  const double middle = 0.5 * camera.width_px;
  const double place = col - head.shift_col_px - head.stripe_slope * (col - middle);
  const double phase = 2 * std::numbers::pi * place / period_px(camera);
  const double stripe = 0.15 + 0.85 * std::exp(4 * (std::cos(phase) - 1));
  const double skin = inside * texture * (1 + head.blink_frac * eye);
  return kLitDn * skin * (head.light * stripe + head.ambient_frac);
}

inline Image<std::uint16_t> photograph(const StripedHead& head, const CameraInfo& camera) {
  Image<std::uint16_t> frame(camera.height_px, camera.width_px);
  std::mt19937_64 random(head.seed);
  const auto normal = [&random] {  // not std::normal_distribution: it differs between libraries
    double sum = -6;
    for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11U) * 0x1.0p-53;
    return sum;
  };
  const double colors[] = {1.25, 0.9, 0.7};
  for (int row = 0; row < camera.height_px; ++row) {
    for (int col = 0; col < camera.width_px; ++col) {
      const auto band = static_cast<std::size_t>(band_at(camera, row, col));
      double dn = colors[band] * light_at(head, camera, row, col);
      if (head.is_noisy) {
        const double electrons = std::max(0.0, dn) * *camera.gain_e_per_dn;
        dn += std::hypot(std::sqrt(electrons), *camera.read_noise_e) / *camera.gain_e_per_dn *
              normal();
      }
      frame.at(row, col) = static_cast<std::uint16_t>(
          std::clamp(std::lround(dn + *camera.black_level_dn), 0L, 4095L));
    }
  }
  return frame;
}

}  // namespace estimation
