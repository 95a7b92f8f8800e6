// Calibration targets: their light against the integral it stands for, and which is there when.
#include "hw_sim/world/board_world.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "hw_sim/world/board_light.h"

namespace hw_sim {
namespace {

using estimation::Image;

Image<unsigned char> stripes_with_square() {
  Image<unsigned char> picture(120, 160);
  for (int row = 0; row < 120; ++row)
    for (int col = 0; col < 160; ++col) picture.at(row, col) = col % 40 < 8 ? 255 : 0;
  for (int row = 0; row < 20; ++row)
    for (int col = 0; col < 20; ++col) picture.at(row, col) = 255;
  return picture;
}

double below(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// Lit squares times a Gaussian, all of them.
double integral(const Image<unsigned char>& picture, double col, double row, double blur) {
  double sum = 0;
  for (int r = 0; r < picture.height_px(); ++r)
    for (int c = 0; c < picture.width_px(); ++c)
      sum += picture.at(r, c) / 255.0 *
             (below((c + 0.5 - col) / blur) - below((c - 0.5 - col) / blur)) *
             (below((r + 0.5 - row) / blur) - below((r - 0.5 - row) / blur));
  return sum;
}

TEST(BlurredPicture, IsTheIntegralOverItsSquaresEverywhere) {
  const Image<unsigned char> picture = stripes_with_square();
  const BlurredPicture blurred(picture, 0.6, 1.4);
  for (const double blur : {0.6, 0.83, 1.4})
    for (const auto& [col, row] :
         {std::pair(80.3, 60.0), {87.6, 77.7}, {19.4, 19.8}, {40.1, 0.2}, {159.4, 118.9}, {3, 3}})
      EXPECT_NEAR(blurred.at(col, row, blur), integral(picture, col, row, blur), 1e-3)
          << col << ' ' << row << ' ' << blur;
  EXPECT_EQ(blurred.at(-30, 60, 1), 0);
}

TEST(TargetScene, UnknownNamesAreToldWithTheKnown) {
  const auto scene = make_target_scene("teapot");
  ASSERT_FALSE(scene);
  EXPECT_THAT(scene.error().detail, testing::HasSubstr("board, standard"));
}

class Targets : public testing::Test {
 protected:
  // Mean of a frame under white, DN above black.
  double mean_dn(std::size_t captures_begun) {
    captures_begun_ = captures_begun;
    Image<std::uint16_t> frame(36, 49);
    Exposure exposure;
    auto white = std::make_shared<Picture>();
    white->id = 1;
    white->brightness = Image<unsigned char>(768, 1024, 1, 255);
    exposure.light = {{white, std::chrono::microseconds(10000)}};
    exposure.duration = std::chrono::microseconds(10000);
    exposure.trigger_number = 1;
    world_->expose(exposure, frame.view());
    double sum = 0;
    for (const std::uint16_t dn : frame.samples()) sum += dn - 64.0;
    return sum / static_cast<double>(frame.samples().size());
  }

  void SetUp() override {
    estimation::CameraInfo camera;
    camera.width_px = 49;
    camera.height_px = 36;
    camera.pixel_format = {estimation::ColorFilter::kMono, 12};
    camera.black_level_dn = 64;
    camera.gain_e_per_dn = 4.88;
    camera.read_noise_e = 10;
    estimation::Calibration calibration;
    calibration.camera.K = estimation::Mat3(157, 0, 24, 0, 157, 17.5, 0, 0, 1);
    calibration.projector.K = estimation::Mat3(2500, 0, 511.5, 0, 2500, 383.5, 0, 0, 1);
    calibration.projector_from_camera_mm = {1, 0, 0};  // beside the camera: light falls straight
    calibration.irradiance = estimation::Irradiance{
        .signal_per_us = {0.2}, .reference_distance_mm = 1000, .vignetting_file = {}};
    auto scene = make_target_scene("standard");
    ASSERT_TRUE(scene);
    auto world = TargetWorld::create(camera, {1024, 768, {}}, calibration, *scene, {}, 1,
                                     [this] { return captures_begun_; });
    ASSERT_TRUE(world) << world.error().detail;
    world_ = std::move(*world);
  }

  std::size_t captures_begun_ = 0;
  std::unique_ptr<TargetWorld> world_;
};

TEST_F(Targets, EachCaptureHasTheNext) {
  EXPECT_NEAR(mean_dn(0), 0, 0.5);  // capped
  EXPECT_NEAR(mean_dn(1), 0, 0.5);
  const double standard_dn = mean_dn(2), near_dn = mean_dn(4), middle_dn = mean_dn(5);
  // 0.2 DN/us, 10 ms, reflectance 0.99, turned by 7 degrees and 1, nearly at the reference.
  EXPECT_NEAR(standard_dn / (2000 * 0.99 * std::cos(7.07 / 180 * std::numbers::pi)), 1, 0.02);
  EXPECT_NEAR(middle_dn / standard_dn, 0.8 / 0.99, 0.001);
  EXPECT_NEAR(near_dn / middle_dn, 1000.0 * 1000 / 950 / 950, 0.005);
  EXPECT_EQ(mean_dn(99), mean_dn(6));  // the last one stays
}

}  // namespace
}  // namespace hw_sim
