#include "estimation/refine/near_discontinuity.h"

#include <gtest/gtest.h>

#include "tests/estimation/refine/line_scene.h"

namespace estimation {
namespace {

constexpr double kTranslucencyMm = 2;

LineScene plane() {
  LineScene scene;
  scene.place([](double) { return LineScene::Point{}; });
  return scene;
}

struct Material {
  Image<float> reflectance, translucency_mm;
  BandMaterial view() const { return {reflectance.view(), translucency_mm.view()}; }
};

// Noise of a hash: the same on every machine.
Material even_material(const LineScene& scene, float noise_frac) {
  Material material{Image<float>(scene.height_px, scene.width_px),
                    Image<float>(scene.height_px, scene.width_px)};
  std::uint32_t state = 1;
  const auto noise = [&] {
    state = state * 1664525U + 1013904223U;
    return 1 + noise_frac * (static_cast<float>(state >> 8) / 8388608.0F - 1);
  };
  for (float& value : material.reflectance.samples()) value = 0.5F * noise();
  for (float& value : material.translucency_mm.samples())
    value = static_cast<float>(kTranslucencyMm) * noise();
  return material;
}

int count_of(const Image<unsigned char>& mask) {
  int count = 0;
  for (const unsigned char flag : mask.samples()) count += flag;
  return count;
}

TEST(NearDiscontinuity, EvenSkinHasNone) {
  const LineScene scene = plane();
  EXPECT_EQ(count_of(near_discontinuity(scene.surface(), even_material(scene, 0.1F).view())), 0);
}

TEST(NearDiscontinuity, ReachesTheGivenMultipleOfTheMeanFreePath) {
  LineScene scene;
  scene.edge_mm = 5.25;  // between two pixels
  scene.place([](double) { return LineScene::Point{}; });
  const Material material = even_material(scene, 0);
  const auto near = near_discontinuity(scene.surface(), material.view(), {.reach = 2});
  for (int col = 0; col < scene.width_px; ++col) {
    const double x = scene.x_mm(col);
    const bool is_expected = x < scene.edge_mm && x > scene.edge_mm - 2 * kTranslucencyMm;
    EXPECT_EQ(near.at(30, col) != 0, is_expected) << x << " mm";
  }
}

TEST(NearDiscontinuity, LostPixelIsNoHole) {
  LineScene scene = plane();
  const Material material = even_material(scene, 0);
  scene.validity.at(30, 60) = kSaturated;
  EXPECT_EQ(count_of(near_discontinuity(scene.surface(), material.view())), 0);
  for (int row = 28; row < 33; ++row)
    for (int col = 58; col < 63; ++col) scene.validity.at(row, col) = kNoCorrespondence;
  const auto near = near_discontinuity(scene.surface(), material.view());
  EXPECT_EQ(near.at(30, 66), 1);
  EXPECT_EQ(near.at(30, 60), 0);  // nothing lit there
  EXPECT_EQ(near.at(30, 20), 0);
}

TEST(NearDiscontinuity, JumpInDepthIsABorder) {
  LineScene scene;
  scene.place([](double x) { return LineScene::Point{x > 0.25 ? 20.0 : 0.0, 0}; });
  const auto near = near_discontinuity(scene.surface(), even_material(scene, 0.1F).view());
  EXPECT_EQ(near.at(30, 61), 1);
  EXPECT_EQ(near.at(30, 57), 1);
  EXPECT_EQ(near.at(30, 20), 0);
  EXPECT_EQ(near.at(30, 100), 0);
}

TEST(NearDiscontinuity, StepOfMaterialIsABorderAndNoiseIsNot) {
  const LineScene scene = plane();
  Material material = even_material(scene, 0.1F);
  for (int row = 0; row < scene.height_px; ++row)
    for (int col = 60; col < scene.width_px; ++col) material.reflectance.at(row, col) *= 1.3F;
  const auto near = near_discontinuity(scene.surface(), material.view());
  EXPECT_EQ(near.at(30, 59), 1);
  EXPECT_EQ(near.at(30, 62), 1);
  EXPECT_EQ(near.at(30, 30), 0);
  EXPECT_EQ(near.at(30, 95), 0);
}

}  // namespace
}  // namespace estimation
