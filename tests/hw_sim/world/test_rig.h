// A small calibrated rig for the world's tests: the reference session's geometry with fewer pixels.
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "estimation/session/manifest.h"
#include "estimation/session/pattern.h"
#include "hw_sim/world/head_world.h"

namespace hw_sim {

struct TestRig {
  estimation::CameraInfo camera;
  estimation::ProjectorInfo projector;
  estimation::Calibration calibration;
};

// A camera of width x height px on the field of view of 588 x 432 at 1880 px focal length; the
// projector's 1024 x 768 px divided by `projector_divisor`.
inline TestRig make_test_rig(int width_px = 147, int height_px = 108, int projector_divisor = 2) {
  TestRig rig;
  rig.camera.width_px = width_px;
  rig.camera.height_px = height_px;
  rig.camera.pixel_format = {estimation::ColorFilter::kBayerRG, 12};
  rig.camera.black_level_dn = 64;
  rig.camera.saturation_level_dn = 4000;
  rig.camera.gain_e_per_dn = 4.88;
  rig.camera.read_noise_e = 10;
  rig.projector.width_px = 1024 / projector_divisor;
  rig.projector.height_px = 768 / projector_divisor;
  estimation::Calibration& c = rig.calibration;
  const double camera_f_px = 1880.0 * width_px / 588;
  c.camera.K = {camera_f_px, 0, (width_px - 1) / 2.0, 0, camera_f_px, (height_px - 1) / 2.0, 0,
                0,           1};
  const double f_px = 3405.528085954478 / projector_divisor;
  c.projector.K = {f_px, 0,    (rig.projector.width_px - 1) / 2.0,
                   0,    f_px, (rig.projector.height_px - 1) / 2.0,
                   0,    0,    1};
  c.projector_from_camera = {0.9701425001453319,   0,
                             -0.24253562503633297, 0.004704996789825894,
                             0.9998118178380025,   0.018819987159303577,
                             0.24248998415805223,  -0.019399198732644177,
                             0.9699599366322089};
  c.projector_from_camera_mm = {242.53562503633296, -18.819987159303576, 61.01048001416594};
  c.irradiance = estimation::Irradiance{{0.2, 0.19, 0.17}, 1030.970416646375, {}};
  return rig;
}

// So many electrons a DN that noise vanishes: what is left is quantisation.
inline void remove_noise(TestRig& rig) {
  rig.camera.gain_e_per_dn = 1e12;
  rig.camera.read_noise_e = 0;
}

inline std::unique_ptr<HeadWorld> make_world(const TestRig& rig, const SceneOptions& options) {
  auto world = HeadWorld::create(rig.camera, rig.projector, rig.calibration, options);
  EXPECT_TRUE(world) << (world ? "" : world.error().detail);
  return world ? std::move(*world) : nullptr;
}

inline Picture make_picture(const TestRig& rig, const estimation::PatternKind& kind,
                            std::uint64_t id = 1) {
  return {id, estimation::render_pattern(kind, rig.projector.height_px, rig.projector.width_px)};
}

}  // namespace hw_sim
