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
  const BlurredPicture blurred(picture, 1, 0.6, 1.4);
  for (const double blur : {0.6, 0.83, 1.4})
    for (const auto& [col, row] :
         {std::pair(80.3, 60.0), {87.6, 77.7}, {19.4, 19.8}, {40.1, 0.2}, {159.4, 118.9}, {3, 3}})
      EXPECT_NEAR(blurred.at(col, row, blur), integral(picture, col, row, blur), 1e-3)
          << col << ' ' << row << ' ' << blur;
  EXPECT_EQ(blurred.at(-30, 60, 1), 0);
}

TEST(BlurredPicture, GreysAreLitByTheirPower) {
  const Image<unsigned char> grey(120, 160, 1, 128);
  EXPECT_NEAR(BlurredPicture(grey, 2.2, 0.5, 0.5).at(80, 60, 0.5), std::pow(128 / 255.0, 2.2),
              1e-6);
}

TEST(TargetScene, UnknownNamesAreToldWithTheKnown) {
  const auto scene = make_target_scene("teapot");
  ASSERT_FALSE(scene);
  EXPECT_THAT(scene.error().detail, testing::HasSubstr("board, standard"));
}

std::shared_ptr<const Picture> picture_of(std::uint64_t id, Image<unsigned char> brightness) {
  auto picture = std::make_shared<Picture>();
  picture->id = id;
  picture->brightness = std::move(brightness);
  return picture;
}

std::shared_ptr<const Picture> white() {
  return picture_of(1, Image<unsigned char>(768, 1024, 1, 255));
}

// Lit up to 3 mm from the middle of a target at a metre: 5 px, and the mm that the projector stands
// aside.
std::shared_ptr<const Picture> edge() {
  Image<unsigned char> brightness(768, 1024);
  for (int row = 0; row < 768; ++row)
    for (int col = 0; col < 507; ++col) brightness.at(row, col) = 255;
  return picture_of(2, std::move(brightness));
}

class Targets : public testing::Test {
 protected:
  static constexpr int kHeight = 36, kWidth = 49;

  Image<std::uint16_t> frame_of(std::size_t captures_begun, std::shared_ptr<const Picture> picture,
                                std::chrono::milliseconds start = {}) {
    captures_begun_ = captures_begun;
    Image<std::uint16_t> frame(kHeight, kWidth);
    Exposure exposure;
    exposure.light = {{std::move(picture), std::chrono::microseconds(10000)}};
    exposure.duration = std::chrono::microseconds(10000);
    exposure.start = start;
    exposure.trigger_number = 1;
    world_->expose(exposure, frame.view());
    return frame;
  }

  // Of a frame, DN above black.
  static double mean_dn(const Image<std::uint16_t>& frame) {
    double sum = 0;
    for (const std::uint16_t dn : frame.samples()) sum += dn - 64.0;
    return sum / static_cast<double>(frame.samples().size());
  }
  double mean_dn(std::size_t captures_begun) { return mean_dn(frame_of(captures_begun, white())); }

  // Of a column, over its rows, relative to white.
  double relative_dn(std::size_t captures_begun, int col) {
    const auto lit = frame_of(captures_begun, edge()), even = frame_of(captures_begun, white());
    double sum = 0, white_sum = 0;
    for (int row = 0; row < kHeight; ++row) {
      sum += lit.at(row, col) - 64.0;
      white_sum += even.at(row, col) - 64.0;
    }
    return sum / white_sum;
  }

  void make(const char* scene_name, const Effects& effects) {
    estimation::CameraInfo camera;
    camera.width_px = kWidth;
    camera.height_px = kHeight;
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
    auto scene = make_target_scene(scene_name);
    ASSERT_TRUE(scene);
    auto world = TargetWorld::create(camera, {1024, 768, {}}, calibration, *scene, effects, 1,
                                     [this] { return captures_begun_; });
    ASSERT_TRUE(world) << world.error().detail;
    world_ = std::move(*world);
  }
  void SetUp() override { make("standard", {}); }

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

TEST_F(Targets, LightComesOutBesideWhereItEntersATranslucentOne) {
  constexpr std::size_t kStandard = 3, kPlastic = 5;
  constexpr int kMiddle = 24;  // 3 mm from the lit columns
  for (const std::size_t capture : {kStandard, kPlastic})
    EXPECT_NEAR(relative_dn(capture, kMiddle), 0, 0.003);
  make("translucent", {});
  EXPECT_NEAR(relative_dn(kStandard, kMiddle), 0, 0.003);
  // 0.22 and 0.1 of the light, spread by 1.1 and 2.5 mm.
  EXPECT_NEAR(relative_dn(kPlastic, kMiddle), 0.22 * below(-3 / 1.1) + 0.1 * below(-3 / 2.5),
              0.003);
  EXPECT_NEAR(relative_dn(kPlastic, kMiddle - 4), 1, 0.003);
}

TEST_F(Targets, TheLampsRippleIsInThem) {
  Effects ripple;
  ripple.ripple_frac = 0.1;
  ripple.ripple_hz = 70;  // not of whole turns in 10 ms
  make("standard", ripple);
  const double first = mean_dn(frame_of(2, white()));
  const double second = mean_dn(frame_of(2, white(), std::chrono::milliseconds(7)));
  EXPECT_GT(std::abs(first / second - 1), 0.01);
}

TEST_F(Targets, TheCamerasBlurIsInThem) {
  EXPECT_NEAR(relative_dn(5, 24), 0, 0.003);
  Effects blur;
  blur.camera_blur_px = 1.5;
  make("standard", blur);
  // Pixels of 6.4 mm.
  EXPECT_NEAR(relative_dn(5, 24), below(-3 / std::hypot(1.5 * 6.4, 6.4 / std::sqrt(12.0))), 0.02);
}

}  // namespace
}  // namespace hw_sim
