// What the projector does to its pictures, seen through the in-process devices.
#include <gtest/gtest.h>

#include "tests/hw_sim/world/phantom_shots.h"

namespace hw_sim {
namespace {

using estimation::Axis;
using estimation::Black;
using estimation::PatternKind;
using estimation::Stripes;
using estimation::White;

constexpr int kRow = 18, kCol = 25;

double sinc(double x) { return std::sin(std::numbers::pi * x) / (std::numbers::pi * x); }

// Contrast of harmonic n of a pixel under stripes of every shift.
double contrast(const std::vector<Shot>& sweep, int n) {
  std::complex<double> sum = 0;
  for (std::size_t shift = 0; shift < sweep.size(); ++shift)
    sum += std::polar(1.0, 2 * std::numbers::pi * n * static_cast<double>(shift) /
                               static_cast<double>(sweep.size())) *
           sweep[shift].at(kRow, kCol);
  return std::abs(sum);
}

TEST(ProjectorEffects, BlurAndThePixelsShapeAreTheirTransfer) {
  std::vector<PatternKind> sweep;
  for (int shift = 0; shift < 40; ++shift) sweep.push_back(Stripes{Axis::kColumn, 40, 8, shift});
  const std::vector<microseconds> exposure = {microseconds(40000)};
  const auto sharp = phantom_shots({}, sweep, exposure);
  Effects small;
  small.pixel_fill_frac = 0.3;
  Effects soft;
  soft.blur_px = 0.8;
  const auto small_pixels = phantom_shots(small, sweep, exposure);
  const auto blurred = phantom_shots(soft, sweep, exposure);
  for (const int n : {1, 2, 4, 6}) {
    EXPECT_NEAR(contrast(small_pixels, n) / contrast(sharp, n), sinc(0.3 * n / 40) / sinc(n / 40.0),
                0.006)
        << n;
    EXPECT_NEAR(contrast(blurred, n) / contrast(sharp, n),
                std::exp(-2 * std::pow(std::numbers::pi * n * 0.8 / 40, 2)), 0.006)
        << n;
  }
}

TEST(ProjectorEffects, GammaTurnsGreysAndSparesBlackAndWhite) {
  // A fringe so wide that it is one grey: 128 of 255.
  const std::vector<PatternKind> patterns = {estimation::Fringe{Axis::kColumn, 1e9, 2.5e8}, White{},
                                             Stripes{Axis::kRow, 16, 8, 3}};
  const auto linear = phantom_shots({}, patterns);
  Effects effects;
  effects.gamma = 2.2;
  const auto curved = phantom_shots(effects, patterns);
  const TestRig rig = quiet_rig();
  const double grey = 128.0 / 255;
  EXPECT_NEAR(mean_signal(rig, linear[0], 1) / mean_signal(rig, linear[1], 1), grey, 0.003);
  EXPECT_NEAR(mean_signal(rig, curved[0], 1) / mean_signal(rig, curved[1], 1), std::pow(grey, 2.2),
              0.003);
  for (const std::size_t binary : {1U, 2U})
    EXPECT_TRUE(std::ranges::equal(linear[binary].dn.samples(), curved[binary].dn.samples()));
}

TEST(ProjectorEffects, BlackLeaks) {
  Effects effects;
  effects.black_frac = 0.02;
  const auto shots = phantom_shots(effects, {Black{}, White{}}, {microseconds(40000)});
  const TestRig rig = quiet_rig();
  EXPECT_NEAR(mean_signal(rig, shots[0], 1) / mean_signal(rig, shots[1], 1), 0.02 / 1.02, 4e-4);
}

TEST(ProjectorEffects, VignettingFollowsTheProjectorsPicture) {
  Effects effects;
  effects.vignetting_frac = 0.6;
  const TestRig rig = quiet_rig();
  const auto plain = phantom_shots({}, {White{}}, {microseconds(40000)});
  const auto dim = phantom_shots(effects, {White{}}, {microseconds(40000)});
  const double half_height = (rig.projector.height_px - 1) / 2.0;
  const double half_width = (rig.projector.width_px - 1) / 2.0;
  for (const auto& [row, col] : {std::pair{18, 25}, std::pair{8, 12}, std::pair{26, 36}}) {
    const ProjectedPoint at = phantom_lamp_px(rig, row, col);
    const double r2 = (std::pow(at.row_px - half_height, 2) + std::pow(at.col_px - half_width, 2)) /
                      (half_height * half_height + half_width * half_width);
    EXPECT_NEAR((dim[0].at(row, col) - kBlackDn) / (plain[0].at(row, col) - kBlackDn), 1 - 0.6 * r2,
                0.002);
  }
}

TEST(ProjectorEffects, CrosstalkMixesTheBandsOfLight) {
  TestRig rig = quiet_rig();
  rig.camera.pixel_format = {estimation::ColorFilter::kRgb, 16};
  // Stripes tell the bands apart by more than their brightness: red bleeds furthest.
  const Stripes stripes{Axis::kColumn, 40, 8, 0};
  const std::vector<microseconds> exposure = {microseconds(100000)};
  Effects effects;
  effects.crosstalk_frac = 0.1;
  const auto plain = phantom_shots(rig, quick_scene("flat_phantom"), {stripes}, exposure);
  const auto mixed = phantom_shots(rig, quick_scene("flat_phantom", effects), {stripes}, exposure);
  const auto& signal_per_us = rig.calibration.irradiance->signal_per_us;
  for (int row = 10; row < 26; ++row)
    for (int col = 14; col < 35; ++col) {
      double factor[3];
      for (int band = 0; band < 3; ++band)
        factor[band] = (plain[0].at(row, col, band) - kBlackDn) /
                       signal_per_us[static_cast<std::size_t>(band)];
      for (int band = 0; band < 3; ++band)
        EXPECT_NEAR(mixed[0].at(row, col, band) - kBlackDn,
                    signal_per_us[static_cast<std::size_t>(band)] *
                        (0.7 * factor[band] + 0.1 * (factor[0] + factor[1] + factor[2])),
                    2);
    }
}

TEST(ProjectorEffects, InputLagDelaysTheLightByRefreshes) {
  Effects effects;
  effects.input_lag_refreshes = 3;
  const auto prompt = phantom_shots({}, {White{}}), late = phantom_shots(effects, {White{}});
  EXPECT_NEAR(static_cast<double>((late[0].edge_after_swap - prompt[0].edge_after_swap).count()),
              3 * 16'666'667, 5);
  EXPECT_TRUE(std::ranges::equal(late[0].dn.samples(), prompt[0].dn.samples()));
}

TEST(ProjectorEffects, RowsAreScannedOutFromTopToBottom) {
  Effects effects;
  effects.scanout_ms = 16;
  const TestRig rig = quiet_rig();
  const auto world = make_world(rig, quick_scene("flat_phantom", effects));
  const std::vector<microseconds> exposure = {microseconds(10000)};
  const auto plain = phantom_shots({}, {Black{}, White{}}, exposure);
  // The square in the last rows: when it flips the whole picture is out.
  RigShots good(rig, *world, rig::Corner::kBottomRight);
  const auto whole = good.take({Black{}, White{}}, exposure);
  // In the first rows: the shutter opens on the picture before.
  RigShots bad(rig, *world, rig::Corner::kTopLeft);
  const auto torn = bad.take({Black{}, White{}}, exposure);
  const double height = rig.projector.height_px;
  int half_lit = 0;
  for (int row = 8; row < 28; ++row) {
    const int col = 24;
    const double full = plain[1].at(row, col) - kBlackDn;
    EXPECT_NEAR(whole[1].at(row, col) - kBlackDn, full, 2) << row;
    const double delay_ms = 16 * (phantom_lamp_px(rig, row, col).row_px - 4) / height;
    const double lit = std::clamp((10 - delay_ms) / 10, 0.0, 1.0);
    EXPECT_NEAR(torn[1].at(row, col) - kBlackDn, lit * full, 0.003 * full + 1) << row;
    half_lit += lit > 0.1 && lit < 0.9 ? 1 : 0;
  }
  EXPECT_GT(half_lit, 5);
}

TEST(ProjectorEffects, AColourWheelRipplesInEachBandByItself) {
  Effects effects;
  effects.ripple_frac = 0.5;
  effects.ripple_hz = 200;
  const TestRig rig = quiet_rig();
  const std::vector<microseconds> exposures = {microseconds(1000), microseconds(5000)};
  const auto plain = phantom_shots({}, {White{}}, exposures);
  const auto rippled = phantom_shots(effects, {White{}}, exposures);
  double sum = 0, squares = 0;
  for (int band = 0; band < 3; ++band) {
    const double ratio = mean_signal(rig, rippled[0], band) / mean_signal(rig, plain[0], band);
    sum += ratio;
    squares += (ratio - 1) * (ratio - 1);
    // A whole turn of the wheel: nothing is left of it.
    EXPECT_NEAR(mean_signal(rig, rippled[1], band) / mean_signal(rig, plain[1], band), 1, 0.003);
  }
  // Three phases a third apart, whatever the first: their mean is 1, their squares add up to 3/2.
  const double depth = 0.5 * sinc(0.2);
  EXPECT_NEAR(sum, 3, 0.01);
  EXPECT_NEAR(squares, 1.5 * depth * depth, 0.02 * depth * depth);
}

}  // namespace
}  // namespace hw_sim
