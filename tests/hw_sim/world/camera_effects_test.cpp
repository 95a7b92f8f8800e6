// What the camera does to the light, seen through the in-process devices.
#include <gtest/gtest.h>

#include <algorithm>

#include "hw_sim/world/camera_blur.h"
#include "hw_sim/world/direct_light.h"
#include "tests/hw_sim/world/phantom_shots.h"

namespace hw_sim {
namespace {

using estimation::Axis;
using estimation::Black;
using estimation::Image;
using estimation::Stripes;
using estimation::Vec3;
using estimation::White;

TEST(CameraBlur, ContrastIsTheGaussiansAtEachPixelsOwnBlur) {
  constexpr int kHeight = 24, kWidth = 96;
  for (const int pitch : {1, 2})
    for (const double period : {12.0, 24.0}) {
      // Blur grows from column to column; the contrast is read where it is known.
      Image<float> blur_px(kHeight, kWidth), wave(kHeight, kWidth);
      const auto blur_at = [](int col) { return 0.5 + 0.01 * col; };
      for (int row = 0; row < kHeight; ++row)
        for (int col = 0; col < kWidth; ++col) {
          blur_px.at(row, col) = static_cast<float>(blur_at(col));
          wave.at(row, col) = static_cast<float>(std::cos(2 * std::numbers::pi * row / period));
        }
      CameraBlur(std::move(blur_px), pitch).apply(wave);
      for (const int col : {20, 48, 70}) {
        const double expected =
            std::exp(-2 * std::pow(std::numbers::pi * blur_at(col) / period, 2));
        EXPECT_NEAR(static_cast<double>(wave.at(12, col)),
                    expected * std::cos(2 * std::numbers::pi * 12 / period), 0.012)
            << pitch << " " << period << " " << col;
      }
    }
}

TEST(CameraEffects, PointSpreadAndDefocusSoftenTheOutlineAndKeepTheLight) {
  Effects sharp, soft, unfocused;
  soft.camera_blur_px = 0.8;
  unfocused.camera_focus_mm = 900;
  unfocused.camera_defocus_px_per_mm = 0.02;  // 2 px at the phantom
  double steepest[3], sum[3];
  int i = 0;
  for (const Effects& effects : {sharp, soft, unfocused}) {
    TestRig rig = quiet_rig();
    rig.camera.pixel_format.filter = estimation::ColorFilter::kMono;
    rig.calibration.irradiance->signal_per_us = {0.2};
    const auto shots =
        phantom_shots(rig, quick_scene("flat_phantom", effects), {White{}}, {microseconds(20000)});
    steepest[i] = sum[i] = 0;
    for (int col = 24; col < 48; ++col) {
      steepest[i] =
          std::max(steepest[i], std::abs(shots[0].at(18, col + 1) - shots[0].at(18, col)));
      sum[i] += shots[0].at(18, col + 1) - kBlackDn;
    }
    ++i;
  }
  EXPECT_LT(steepest[1], 0.7 * steepest[0]);
  EXPECT_LT(steepest[2], 0.6 * steepest[1]);
  EXPECT_NEAR(sum[1] / sum[0], 1, 0.01);
  EXPECT_NEAR(sum[2] / sum[0], 1, 0.01);
}

TEST(CameraEffects, VignettingFollowsTheCamerasPicture) {
  Effects effects;
  effects.camera_vignetting_frac = 0.3;
  const auto plain = phantom_shots({}, {White{}}), dim = phantom_shots(effects, {White{}});
  const double corner2 = 24 * 24 + 17.5 * 17.5;
  for (const auto& [row, col] : {std::pair{18, 25}, std::pair{8, 12}, std::pair{27, 36}})
    EXPECT_NEAR((dim[0].at(row, col) - kBlackDn) / (plain[0].at(row, col) - kBlackDn),
                1 - 0.3 * (std::pow(row - 17.5, 2) + std::pow(col - 24.0, 2)) / corner2, 0.004);
}

TEST(CameraEffects, AFullWellHoldsNoMore) {
  Effects effects;
  effects.full_well_e = 4880;  // 1000 DN
  const TestRig rig = make_test_rig(49, 36, 2);
  const auto shots = phantom_shots(rig, quick_scene("flat_phantom", effects), {White{}},
                                   {microseconds(5000), microseconds(60000)});
  EXPECT_LT(shots[0].at(18, 25), 600);
  for (int row = 12; row < 24; ++row)
    for (int col = 15; col < 33; ++col) EXPECT_EQ(shots[1].at(row, col), 1064);
}

TEST(CameraEffects, FixedPatternStaysFromFrameToFrame) {
  Effects effects;
  effects.pixel_gain_sd_frac = 0.03;
  effects.pixel_offset_sd_dn = 6;
  const auto plain = phantom_shots({}, {Black{}, White{}}, {microseconds(40000)});
  const auto shots = phantom_shots(effects, {Black{}, White{}, Black{}}, {microseconds(40000)});
  SceneOptions other = quick_scene("flat_phantom", effects);
  other.seed = 2;
  const auto reseeded = phantom_shots(quiet_rig(), other, {Black{}}, {microseconds(40000)});
  double offset2 = 0, gain2 = 0, along = 0;
  int count = 0;
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col) {
      EXPECT_EQ(shots[0].at(row, col), shots[2].at(row, col));
      const double offset = shots[0].at(row, col) - plain[0].at(row, col);
      const double gain = (shots[1].at(row, col) - shots[0].at(row, col)) /
                          (plain[1].at(row, col) - plain[0].at(row, col));
      offset2 += offset * offset;
      gain2 += (gain - 1) * (gain - 1);
      along += offset * (reseeded[0].at(row, col) - kBlackDn);
      ++count;
    }
  const double tolerance = 4 / std::sqrt(2.0 * count);
  EXPECT_NEAR(std::sqrt(offset2 / count), 6, 6 * tolerance);
  EXPECT_NEAR(std::sqrt(gain2 / count), 0.03, 0.03 * tolerance);
  EXPECT_NEAR(along / count / 36, 0, 4 / std::sqrt(count));  // another sensor, another pattern
}

TEST(CameraEffects, HotPixelsGrowWithTheExposure) {
  Effects effects;
  effects.hot_pixel_frac = 0.2;
  effects.hot_pixel_dn_per_s = 5000;
  const auto shots = phantom_shots(effects, {Black{}}, {microseconds(20000), microseconds(80000)});
  double hot = 0, sum[2] = {0, 0};
  int count = 0;
  for (int row = 0; row < 36; ++row)
    for (int col = 6; col < 49; ++col) {  // beside the identity's block
      hot += shots[1].at(row, col) > 64 ? 1 : 0;
      for (std::size_t i = 0; i < 2; ++i) sum[i] += shots[i].at(row, col) - kBlackDn;
      ++count;
    }
  EXPECT_NEAR(hot / count, 0.2, 4 * std::sqrt(0.2 * 0.8 / count));
  EXPECT_NEAR(sum[1] / sum[0], 4, 0.05);
  // Exponential: mean 0.2 x 5000 x 0.08 s, standard deviation of its mean as large as its root.
  EXPECT_NEAR(sum[1] / count, 80, 4 * 400 * std::sqrt(2 * 0.2 / count));
}

TEST(CameraEffects, EightBitsAreTwelveOverSixteen) {
  TestRig twelve = quiet_rig(), eight = quiet_rig();
  eight.camera.pixel_format.bit_depth = 8;
  eight.camera.black_level_dn = 4;
  for (double& signal : eight.calibration.irradiance->signal_per_us) signal /= 16;
  const std::vector<microseconds> exposures = {microseconds(20000), microseconds(200000)};
  const auto fine = phantom_shots(twelve, quick_scene("flat_phantom"), {White{}}, exposures);
  const auto coarse = phantom_shots(eight, quick_scene("flat_phantom"), {White{}}, exposures);
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col) {
      EXPECT_NEAR(coarse[0].at(row, col), fine[0].at(row, col) / 16, 0.6);
      EXPECT_EQ(coarse[1].at(row, col), 255);
      EXPECT_EQ(fine[1].at(row, col), 4095);
    }
}

TEST(CameraEffects, EveryColourFilterSeesTheSameLight) {
  TestRig bayer = quiet_rig(), rgb = quiet_rig(), mono = quiet_rig();
  rgb.camera.pixel_format = {estimation::ColorFilter::kRgb, 16};
  mono.camera.pixel_format.filter = estimation::ColorFilter::kMono;
  mono.calibration.irradiance->signal_per_us = {0.19};
  const auto scene = quick_scene("flat_phantom");
  const Stripes stripes{Axis::kColumn, 40, 8, 5};
  const auto mosaic = phantom_shots(bayer, scene, {stripes}, {microseconds(40000)});
  const auto full = phantom_shots(rgb, scene, {stripes}, {microseconds(40000)});
  const auto grey = phantom_shots(mono, scene, {stripes}, {microseconds(40000)});
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col) {
      EXPECT_EQ(mosaic[0].at(row, col),
                full[0].at(row, col, estimation::band_at(bayer.camera, row, col)));
      EXPECT_EQ(grey[0].at(row, col), full[0].at(row, col, 1));
    }
}

TEST(Shine, IsReciprocalAndReflectsNoMoreThanItReceives) {
  const Vec3 normal(0, 0, 1);
  const auto at = [](double polar, double azimuth) {
    return Vec3(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
                std::cos(polar));
  };
  EXPECT_NEAR(shine(normal, at(0.3, 0), at(1.1, 2), 0.35),
              shine(normal, at(1.1, 2), at(0.3, 0), 0.35), 1e-12);
  for (const double incidence : {0.0, 0.7, 1.2}) {
    double reflected = 0;
    constexpr int kSteps = 200;
    for (int i = 0; i < kSteps; ++i)
      for (int j = 0; j < kSteps; ++j) {
        const double polar = (i + 0.5) / kSteps * std::numbers::pi / 2;
        reflected +=
            shine(normal, at(incidence, 0), at(polar, 2 * std::numbers::pi * j / kSteps), 0.35) *
            std::cos(polar) * std::sin(polar);
      }
    reflected *= std::numbers::pi / 2 / kSteps * 2 / kSteps;  // dpolar dazimuth / pi
    // Fresnel's 0.028 at normal incidence, 0.037 at 40 degrees, 0.12 at 69: rough, a little apart.
    EXPECT_GT(reflected, 0.02);
    EXPECT_LT(reflected, 0.15);
  }
}

TEST(CameraEffects, WithoutCrossPolarisationSkinShinesWhereItMirrorsTheLamp) {
  Effects effects;
  effects.is_cross_polarised = false;
  effects.skin_roughness_frac = 0.15;
  const TestRig rig = quiet_rig();
  const auto crossed = phantom_shots(rig, quick_scene("sphere"), {White{}}, {microseconds(10000)});
  const auto open =
      phantom_shots(rig, quick_scene("sphere", effects), {White{}}, {microseconds(10000)});
  int brightest_row = 0, brightest_col = 0, unchanged = 0, seen = 0;
  double most = 0;
  for (int row = 0; row < 36; ++row)
    for (int col = 6; col < 49; ++col) {
      const double added = open[0].at(row, col) - crossed[0].at(row, col);
      EXPECT_GE(added, 0);
      if (crossed[0].at(row, col) > 200) {
        ++seen;
        unchanged += added < 0.02 * crossed[0].at(row, col) ? 1 : 0;
      }
      if (added <= most) continue;
      most = added;
      brightest_row = row;
      brightest_col = col;
    }
  // The sphere's point whose normal halves the angle between lamp and camera.
  const auto& c = rig.calibration;
  const Vec3 lamp = -(c.projector_from_camera.t() * c.projector_from_camera_mm);
  const Vec3 center(0, 0, 1060);
  Vec3 point = center - Vec3(0, 0, 80);
  for (int i = 0; i < 20; ++i) {
    const Vec3 half = (lamp - point) / cv::norm(lamp - point) - point / cv::norm(point);
    point = center + 80 / cv::norm(half) * half;
  }
  EXPECT_NEAR(brightest_row, c.camera.K(1, 1) * point[1] / point[2] + c.camera.K(1, 2), 1.5);
  EXPECT_NEAR(brightest_col, c.camera.K(0, 0) * point[0] / point[2] + c.camera.K(0, 2), 1.5);
  EXPECT_GT(most, 100);
  EXPECT_GT(unchanged, seen / 3);
}

}  // namespace
}  // namespace hw_sim
