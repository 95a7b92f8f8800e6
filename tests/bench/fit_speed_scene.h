// A face of skin under stripes, as frames in memory: big enough to measure speed on, quick to make.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/harmonic_table.h"
#include "estimation/radiometry/noise.h"
#include "tests/bench/fit_speed.h"

namespace bench {

// design/estimation.md's rig: 20 ke- full well, 10 e- read noise, white at 0.85 of full well.
inline constexpr std::array<double, 2> kSpeedExposuresUs = {1000, 4000};
inline constexpr double kSpeedBlackDn = 64, kSpeedSaturationDn = 4064;
inline constexpr double kSpeedFullSignal = 3.4;  // DN/us
inline constexpr double kSpeedProjectorBlack = 0.002;

struct SpeedBand {
  estimation::ShapePoint skin;          // in the middle of the face
  std::vector<std::uint32_t> elements;  // valid sites, in image order
};

class SpeedScene {
 public:
  explicit SpeedScene(const SpeedOptions& options);

  // R_d and l_d vary over the face in steps of kLevels each, by so much in t and ln l_d.
  static constexpr int kLevels = 8;
  static constexpr double kVariation = 0.15;

  estimation::ShapePoint truth(const SpeedBand& band, std::uint32_t element) const;
  float position_px(std::uint32_t element) const;
  float full_signal(std::uint32_t element) const;
  double contrast(int harmonic) const;  // of the optics
  estimation::ShapeRange range(const SpeedBand& band, bool is_wide) const;
  int harmonic_count(const SpeedBand& band, bool is_wide, int limit) const;

  estimation::StripeShape shape{40, 8};
  std::vector<int> shifts_px;
  std::vector<estimation::MergedNoise> noise;
  std::unique_ptr<estimation::ScatteringModel> model;
  std::array<SpeedBand, 3> bands;
  std::vector<estimation::Image<std::uint16_t>> frames;  // [shift][exposure]

 private:
  int level(std::uint32_t element) const;  // kLevels * that of t + that of ln l_d
  std::vector<float> profiles(const SpeedBand& band) const;
  void expose(std::size_t frame, std::span<const std::vector<float>> profiles,
              std::span<const float> normal);

  int height_px_, width_px_;
  std::vector<std::uint8_t> band_of_;  // [element], 3: background
};

}  // namespace bench
