// The flat phantom before a small quiet camera, photographed by the in-process devices.
#pragma once

#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "hw_sim/world/optics.h"
#include "tests/hw_sim/world/rig_shots.h"

namespace hw_sim {

using std::chrono::microseconds;

inline constexpr int kBlackDn = 64;

// Without noise: what is left is quantisation.
inline TestRig quiet_rig() {
  TestRig rig = make_test_rig(49, 36, 2);
  remove_noise(rig);
  return rig;
}

inline std::vector<Shot> phantom_shots(const TestRig& rig, const SceneOptions& scene,
                                       const std::vector<estimation::PatternKind>& patterns,
                                       const std::vector<microseconds>& exposures) {
  const auto world = make_world(rig, scene);
  return RigShots(rig, *world).take(patterns, exposures);
}

inline std::vector<Shot> phantom_shots(const Effects& effects,
                                       const std::vector<estimation::PatternKind>& patterns,
                                       const std::vector<microseconds>& exposures = {
                                           microseconds(10000)}) {
  return phantom_shots(quiet_rig(), quick_scene("flat_phantom", effects), patterns, exposures);
}

// Mean signal of a band over the middle of the phantom, DN above black.
inline double mean_signal(const TestRig& rig, const Shot& shot, int band) {
  double sum = 0;
  int count = 0;
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col) {
      if (rig.camera.pixel_format.filter != estimation::ColorFilter::kRgb &&
          estimation::band_at(rig.camera, row, col) != band)
        continue;
      const int channel = shot.dn.channel_count() == 3 ? band : 0;
      sum += shot.at(row, col, channel) - kBlackDn;
      ++count;
    }
  return sum / count;
}

// Where on the projector's picture a pixel's place of the phantom is lit from.
inline ProjectedPoint phantom_lamp_px(const TestRig& rig, int row, int col) {
  const auto& c = rig.calibration;
  const estimation::Vec3 at(1000 * (col - c.camera.K(0, 2)) / c.camera.K(0, 0),
                            1000 * (row - c.camera.K(1, 2)) / c.camera.K(1, 1), 1000);
  const estimation::Vec3 local = c.projector_from_camera * at + c.projector_from_camera_mm;
  return {c.projector.K(0, 0) * local[0] / local[2] + c.projector.K(0, 2),
          c.projector.K(1, 1) * local[1] / local[2] + c.projector.K(1, 2), true};
}

}  // namespace hw_sim
