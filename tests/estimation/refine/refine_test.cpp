// What the end of the light, a border of materials and a crease do to the ordinary fit, and what is
// left of that after refinement. Truth: quadrature of eq. 3 over strips of light.
#include <gtest/gtest.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "estimation/refine/apparent_position.h"
#include "tests/estimation/refine/line_truth.h"

namespace estimation {
namespace {

void print_row(double distance, const RelativeError& before, const RelativeError& after) {
  std::printf("  %5.2f | %7.2f %7.2f %7.2f %7.2f | %6.2f %6.2f %6.2f %6.2f\n", distance,
              100 * before.reflectance, 100 * before.translucency, 100 * before.sigma_a,
              100 * before.sigma_s_prime, 100 * after.reflectance, 100 * after.translucency,
              100 * after.sigma_a, 100 * after.sigma_s_prime);
}

constexpr const char* kTableHead =
    "  distance, l_d | error before, %%: R_d, l_d, sigma_a, sigma_s' | after\n";

TEST(Refine, EndOfLightIsTakenOutOfTheFit) {
  const Dipole model(1.4);
  const truth::DipoleLineSpread spread(kCheekRed, 1.4);
  LineScene scene = half_plane_of_light(spread);
  const FittedMaps before = fit_columns(scene, model);
  const FittedMaps after = refine_columns(scene, model, 4);
  std::printf(kTableHead);
  for (int col = 60; col > 30; --col) {
    const double distance =
        (scene.edge_mm - scene.x_mm(col)) / diffuse_mean_free_path_mm(kCheekRed);
    const RelativeError error = error_at(after, col, model, kCheekRed);
    print_row(distance, error_at(before, col, model, kCheekRed), error);
    // The border itself is known to half a camera pixel, a ninth of l_d.
    EXPECT_LT(error.worst(), distance > 1 ? 0.005 : 0.08) << distance << " l_d from the border";
  }
  EXPECT_GT(error_at(before, 60, model, kCheekRed).sigma_a, 2);
  EXPECT_GT(error_at(before, 52, model, kCheekRed).sigma_a, 0.15);  // 1.95 l_d away
}

TEST(Refine, BorderOfMaterialsUnderTheSeenPointsKernelIsLeftAlone) {
  // With the kernel of the seen point, the paper's eq. 7 and the simulator's, the ordinary fit is
  // exact up to the border: nothing to take out, and nothing may be put in.
  const Dipole model(1.4);
  const truth::DipoleLineSpread cheek(kCheekRed, 1.4), lips(kLipsRed, 1.4);
  LineScene scene;
  scene.place([](double) { return LineScene::Point{}; });
  scene.light([&](double x, double start, double end) {
    return flat_strip(x < 0.25 ? cheek : lips)(x, start, end);
  });
  const FittedMaps before = fit_columns(scene, model);
  const FittedMaps after = refine_columns(scene, model, 3);
  for (int col = 40; col <= 80; ++col) {
    const Coefficients& truth = scene.x_mm(col) < 0.25 ? kCheekRed : kLipsRed;
    EXPECT_LT(error_at(before, col, model, truth).worst(), 1e-3) << scene.x_mm(col) << " mm";
    EXPECT_LT(error_at(after, col, model, truth).worst(), 1e-3) << scene.x_mm(col) << " mm";
  }
}

TEST(Refine, CreaseIsTakenOutOfTheFit) {
  const Dipole model(1.4);
  const truth::DipoleLineSpread spread(kCheekRed, 1.4);
  LineScene scene = crease(spread);
  const FittedMaps before = fit_columns(scene, model);
  const FittedMaps after = refine_columns(scene, model, 4);
  std::printf(kTableHead);
  for (int col = 60; col <= 90; col += 2) {
    const double distance = scene.x_mm(col) / diffuse_mean_free_path_mm(kCheekRed);
    const RelativeError error = error_at(after, col, model, kCheekRed);
    print_row(distance, error_at(before, col, model, kCheekRed), error);
    EXPECT_LT(error.worst(), std::abs(distance) > 0.6 ? 0.01 : 0.06) << distance << " l_d";
  }
  EXPECT_GT(error_at(before, 80, model, kCheekRed).sigma_a, 1);
}

TEST(Refine, StripesAreFoundWhereTheyLieInACrease) {
  const Dipole model(1.4);
  const truth::DipoleLineSpread spread(kCheekRed, 1.4);
  const LineScene scene = crease(spread);
  const FittedMaps maps = fit_columns(scene, model);
  const LitSurface surface = scene.surface();
  const SpreadField field =
      spread_field(scene.camera, 0, surface, maps.material(), model, scene.shape);
  const std::vector<SpreadField> fields{field};
  std::vector<ImageView<const float>> views;
  for (const Image<float>& signal : scene.signals) views.push_back(signal.view());
  const StripeSet stripes{.shape = scene.shape, .shifts_px = scene.shifts_px};
  const std::vector<MergedNoise> noise{{.read_variance = 1e-6, .shot_dn_per_us = 1e-4}};
  const Image<float> sd_px(scene.height_px, scene.width_px, 1, 0.1F);
  const Position found =
      true_position({scene.camera, stripes, views, noise}, surface, fields, sd_px.view());
  double before = 0, after = 0;
  for (int col = 60; col <= 100; ++col) {
    const int row = scene.height_px / 2;
    const auto seen = static_cast<double>(maps.phase_px.at(row, col));
    const auto left = static_cast<double>(found.px.at(row, col) - scene.position_px.at(row, col));
    before += seen * seen;
    after += left * left;
    EXPECT_LT(std::abs(left), 0.4);
    EXPECT_LT(found.sd_px.at(row, col), 0.1F);
  }
  std::printf(
      "  rms of the coordinate within 5 mm of the crease: %.3f px as seen, %.3f corrected\n",
      std::sqrt(before / 41), std::sqrt(after / 41));
  EXPECT_LT(after, 0.16 * before);  // from the material as fitted beside the crease, one pass
}

TEST(Refine, SameBitsForAnyNumberOfThreads) {
  const Dipole model(1.4);
  const truth::DipoleLineSpread spread(kCheekRed, 1.4);
  const auto refined = [&](int thread_count) {
    LineScene scene = half_plane_of_light(spread);
    tbb::task_arena(thread_count).execute([&] { refine_columns(scene, model, 1); });
    return std::move(scene.signals);
  };
  const auto one = refined(1), four = refined(4);
  for (std::size_t i = 0; i < one.size(); ++i)
    EXPECT_TRUE(std::ranges::equal(one[i].samples(), four[i].samples())) << "shift " << i;
}

}  // namespace
}  // namespace estimation
