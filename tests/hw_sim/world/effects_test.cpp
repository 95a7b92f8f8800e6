// Each effect against its closed form, on the flat phantom.
#include "hw_sim/world/effects.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <fstream>
#include <numbers>
#include <vector>

#include "tests/hw_sim/world/rig_shots.h"

namespace hw_sim {
namespace {

using estimation::Image;
using estimation::Vec3;
using std::chrono::seconds;
using testing::HasSubstr;

constexpr int kRow = 18, kCol = 25;
constexpr int kPeriod = 40, kWidth = 8;

const TestRig& rig() {
  static const TestRig made = make_test_rig(49, 36, 1);
  return made;
}

// Worlds that differ by their effects alone share their transport.
std::unique_ptr<HeadWorld> world_with(const Effects& effects) {
  return make_world(rig(), quick_scene("flat_phantom", effects));
}

double signal(const HeadWorld& world, const estimation::PatternKind& kind, int row = kRow,
              int col = kCol, std::chrono::nanoseconds elapsed = seconds(0)) {
  return static_cast<double>(world.linear_image(make_picture(rig(), kind), elapsed).at(row, col));
}

// The pixel's samples over a whole period of shifts.
std::vector<double> sweep(const HeadWorld& world, std::chrono::nanoseconds elapsed = seconds(0)) {
  std::vector<double> samples;
  for (int shift = 0; shift < kPeriod; ++shift)
    samples.push_back(signal(world,
                             estimation::Stripes{estimation::Axis::kColumn, kPeriod, kWidth, shift},
                             kRow, kCol, elapsed));
  return samples;
}

std::complex<double> harmonic(const std::vector<double>& samples, int n) {
  std::complex<double> sum = 0;
  for (std::size_t shift = 0; shift < samples.size(); ++shift)
    sum += std::polar(1.0, 2 * std::numbers::pi * n * static_cast<double>(shift) / kPeriod) *
           samples[shift];
  return sum;
}

TEST(Effects, BlurIsAGaussiansContrastAndGrowsOutOfFocus) {
  const auto sharp = sweep(*world_with({}));
  Effects effects;
  effects.blur_px = 0.8;
  const auto soft = sweep(*world_with(effects));
  // The phantom is 1000 mm from the camera; defocus for its distance to the projector.
  effects.focus_mm = 900;
  effects.defocus_px_per_mm = 0.01;
  const auto unfocused = sweep(*world_with(effects));
  const Vec3 lamp =
      -(rig().calibration.projector_from_camera.t() * rig().calibration.projector_from_camera_mm);
  const auto& K = rig().calibration.camera.K;
  const Vec3 at(1000 * (kCol - K(0, 2)) / K(0, 0), 1000 * (kRow - K(1, 2)) / K(1, 1), 1000);
  const double defocused_px = std::hypot(0.8, 0.01 * (cv::norm(at - lamp) - 900));
  EXPECT_GT(defocused_px, 1.2);
  const auto contrast = [](double sigma_px, int n) {
    return std::exp(-2 * std::pow(std::numbers::pi * n * sigma_px / kPeriod, 2));
  };
  for (const int n : {0, 1, 2, 3, 4, 6}) {
    const double all = std::abs(harmonic(sharp, n));
    EXPECT_NEAR(std::abs(harmonic(soft, n)) / all, contrast(0.8, n), 0.003) << n;
    EXPECT_NEAR(std::abs(harmonic(unfocused, n)) / all, contrast(defocused_px, n), 0.005) << n;
  }
}

TEST(Effects, DriftMovesTheLightByWhatTriangulationSays) {
  Effects effects;
  effects.drift_mm_per_s = {3, 5, 0.5};  // sideways in its own plane a plane stays where it is
  const auto world = world_with(effects);
  const auto column_at = [&](double z_mm) {
    const auto& K = rig().calibration.camera.K;
    const Vec3 point(z_mm * (kCol - K(0, 2)) / K(0, 0), z_mm * (kRow - K(1, 2)) / K(1, 1), z_mm);
    const Vec3 local = rig().calibration.projector_from_camera * point +
                       rig().calibration.projector_from_camera_mm;
    return rig().calibration.projector.K(0, 0) * local[0] / local[2];
  };
  const double moved_px = column_at(1001) - column_at(1000);  // after 2 s
  EXPECT_GT(std::abs(moved_px), 0.5);
  const std::vector<double> before = sweep(*world), after = sweep(*world, seconds(2));
  const auto turned = [&](int n) {
    return std::arg(harmonic(after, n) / harmonic(before, n)) * kPeriod /
           (2 * std::numbers::pi * n);
  };
  EXPECT_NEAR(turned(1), moved_px, 0.01);
  EXPECT_NEAR(turned(2), moved_px, 0.01);
}

TEST(Effects, BlackAndVignettingScaleTheLight) {
  Effects effects;
  effects.black_frac = 0.01;
  const auto plain = world_with({});
  const double white = signal(*plain, estimation::White{});
  const auto leaky = world_with(effects);
  EXPECT_NEAR(signal(*leaky, estimation::Black{}), 0.01 * white, 1e-5 * white);
  EXPECT_NEAR(signal(*leaky, estimation::White{}), 1.01 * white, 1e-4 * white);
  Effects lens;
  lens.camera_vignetting_frac = 0.3;
  const auto dim = world_with(lens);
  const double corner2 = 24 * 24 + 17.5 * 17.5;
  for (const auto& [row, col] : {std::pair{18, 25}, std::pair{10, 12}}) {
    const double row_off = row - 17.5, col_off = col - 24.0;
    EXPECT_NEAR(
        signal(*dim, estimation::White{}, row, col) / signal(*plain, estimation::White{}, row, col),
        1 - 0.3 * (row_off * row_off + col_off * col_off) / corner2, 1e-5);
  }
}

TEST(Effects, TheRoomsLightFlickersAtTwiceTheMainsFrequency) {
  TestRig quiet = rig();
  remove_noise(quiet);
  SceneOptions options = quick_scene("flat_phantom");
  options.effects.ambient_frac = 0.2;
  options.effects.flicker_frac = 0.5;
  const auto world = make_world(quiet, options);
  const auto mean_dn = [&](double start_s, int duration_us) {
    Exposure exposure;
    exposure.start = std::chrono::nanoseconds(static_cast<std::int64_t>(start_s * 1e9));
    exposure.duration = std::chrono::microseconds(duration_us);
    exposure.trigger_number = 1;
    Image<std::uint16_t> frame(world->height_px(), world->width_px());
    world->expose(exposure, frame.view());
    double sum = 0;
    for (int row = 14; row < 22; ++row)
      for (int col = 20; col < 28; ++col) sum += frame.at(row, col) - 64.0;
    return sum / 64;
  };
  const double whole = mean_dn(0, 20000);  // two periods of 100 Hz: no flicker is left
  EXPECT_GT(whole, 50);
  EXPECT_NEAR(mean_dn(0.0037, 20000), whole, 1);
  // 1 ms at the crest and in the trough: the mean of 1 +- 0.5 sin over it.
  const double peak = std::sin(0.1 * std::numbers::pi) / (0.1 * std::numbers::pi);
  EXPECT_NEAR(mean_dn(0.0020, 1000) / (whole / 20), 1 + 0.5 * peak, 0.08);
  EXPECT_NEAR(mean_dn(0.0070, 1000) / (whole / 20), 1 - 0.5 * peak, 0.08);
}

TEST(EffectsFile, TheExampleHasEveryKeyAndEachTakesEffect) {
  const auto read = read_effects(SSRIG_CONFIG "/effects.example.toml");
  ASSERT_TRUE(read) << read.error().detail;
  EXPECT_EQ(read->blur_px, 0.7);
  EXPECT_EQ(read->input_lag_refreshes, 1);
  EXPECT_EQ(read->camera_blur_px, 0.4);
  EXPECT_EQ(read->drift_mm_per_s, Vec3(0, 0, 0.2));
  // Without a line the value is the default's, or the line says nothing.
  std::ifstream file(SSRIG_CONFIG "/effects.example.toml");
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  int keys = 0;
  for (std::size_t without = 0; without < lines.size(); ++without) {
    if (lines[without].find(" = ") == std::string::npos || lines[without].starts_with("#"))
      continue;
    ++keys;
    std::string text;
    for (std::size_t i = 0; i < lines.size(); ++i)
      if (i != without) text.append(lines[i]).append("\n");
    const auto rest = parse_effects(text, "e.toml");
    ASSERT_TRUE(rest) << rest.error().detail;
    const bool is_default =
        lines[without].find("focus_mm = 1000") == 0 || lines[without].starts_with("is_cross") ||
        lines[without].starts_with("mains") || lines[without].starts_with("ripple_hz") ||
        lines[without].starts_with("breathing_hz") || lines[without].starts_with("skin_rough");
    EXPECT_EQ(*rest == *read, is_default) << lines[without];
  }
  const auto unknown = parse_effects("[room]\nx = 1", "e.toml");
  ASSERT_FALSE(unknown);
  EXPECT_EQ(keys, std::ranges::count(unknown.error().detail, ',') + 1);  // of the known ones
}

TEST(EffectsFile, AWrongKeyIsNamed) {
  const auto error_of = [](std::string_view text) {
    const auto effects = parse_effects(text, "e.toml");
    EXPECT_FALSE(effects) << text;
    return effects ? std::string() : effects.error().detail;
  };
  EXPECT_THAT(error_of("[projector]\nblurr_px = 1"), HasSubstr("projector.blurr_px"));
  EXPECT_THAT(error_of("[projector]\nblurr_px = 1"), HasSubstr("projector.blur_px"));
  EXPECT_THAT(error_of("[projector]\nblur_px = -1"), HasSubstr("from 0 to 20"));
  EXPECT_THAT(error_of("[projector]\nblur_px = nan"), HasSubstr("blur_px"));
  EXPECT_THAT(error_of("[projector]\nblur_px = \"1\""), HasSubstr("blur_px"));
  EXPECT_THAT(error_of("[subject]\ndrift_mm_per_s = [1, 2]"), HasSubstr("[x, y, z]"));
  EXPECT_THAT(error_of("[subject]\nbreathing_mm = [1, 2, 1e9]"), HasSubstr("from -100 to 100"));
  EXPECT_THAT(error_of("[projector]\ninput_lag_refreshes = 1.5"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("[camera]\nis_cross_polarised = 1"), HasSubstr("true or false"));
  EXPECT_THAT(error_of("blur_px = 1"), HasSubstr("outside of"));
  EXPECT_THAT(error_of("[projector"), HasSubstr(":1: not TOML"));
  EXPECT_FALSE(read_effects("/nonexistent.toml"));
}

}  // namespace
}  // namespace hw_sim
