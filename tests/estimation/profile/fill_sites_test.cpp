// Bayer sites to every pixel: what is interpolated, and what is not.
#include "estimation/profile/fill_sites.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace estimation {
namespace {

constexpr int kRed = 0, kGreen = 1;

// 4 x 4 px of BayerRG: red sites at even rows and columns. Values are 10 row + col at the sites.
struct Mosaic {
  CameraInfo camera;
  BandFit fit;
  Image<std::uint32_t> pixel_validity{4, 4};

  explicit Mosaic(int band) {
    camera.width_px = camera.height_px = 4;
    camera.pixel_format = {ColorFilter::kBayerRG, 12};
    const float nan = std::numeric_limits<float>::quiet_NaN();
    fit.diffuse_reflectance = Image<float>(4, 4, 1, nan);
    fit.validity = Image<std::uint32_t>(4, 4);
    for (int row = 0; row < 4; ++row)
      for (int col = 0; col < 4; ++col)
        if (band_at(camera, row, col) == band)
          fit.diffuse_reflectance.at(row, col) = static_cast<float>(10 * row + col);
  }
  void lose_site(int row, int col, std::uint32_t reason) {
    fit.diffuse_reflectance.at(row, col) = std::numeric_limits<float>::quiet_NaN();
    fit.validity.at(row, col) = reason;
  }
  float value(int row, int col) const { return fit.diffuse_reflectance.at(row, col); }
};

TEST(FillSites, ALinearMapStaysLinearInside) {
  Mosaic red(kRed), green(kGreen);
  fill_between_sites(red.camera, kRed, red.pixel_validity.view(), red.fit);
  fill_between_sites(green.camera, kGreen, green.pixel_validity.view(), green.fit);
  for (int row = 0; row < 3; ++row)
    for (int col = 0; col < 3; ++col)
      EXPECT_FLOAT_EQ(red.value(row, col), static_cast<float>(10 * row + col));
  for (int row = 1; row < 3; ++row)
    for (int col = 1; col < 3; ++col)
      EXPECT_FLOAT_EQ(green.value(row, col), static_cast<float>(10 * row + col));
  EXPECT_TRUE(red.fit.translucency_px.empty());
}

TEST(FillSites, InvalidSitesTakeNoPartAndTheirReasonSpreadsOnlyWhereNothingElseIs) {
  Mosaic red(kRed);
  red.lose_site(0, 0, kSaturated);
  red.lose_site(0, 2, kTooDark);
  red.fit.validity.at(2, 2) = kPoorFit;
  fill_between_sites(red.camera, kRed, red.pixel_validity.view(), red.fit);
  EXPECT_TRUE(std::isnan(red.value(0, 1)));  // between the two lost sites
  EXPECT_EQ(red.fit.validity.at(0, 1), kSaturated | kTooDark);
  EXPECT_FLOAT_EQ(red.value(1, 2), 22);  // the site below alone
  EXPECT_EQ(red.fit.validity.at(1, 2), kPoorFit);
  EXPECT_FLOAT_EQ(red.value(1, 1), 21);      // between (2, 0) and (2, 2)
  EXPECT_TRUE(std::isnan(red.value(0, 0)));  // a lost site itself is not filled
}

TEST(FillSites, APixelsOwnErrorsStay) {
  Mosaic red(kRed);
  red.pixel_validity.at(1, 1) = kBackground;
  red.pixel_validity.at(2, 1) = kNearDiscontinuity;
  fill_between_sites(red.camera, kRed, red.pixel_validity.view(), red.fit);
  EXPECT_TRUE(std::isnan(red.value(1, 1)));
  EXPECT_EQ(red.fit.validity.at(1, 1), kBackground);
  EXPECT_FLOAT_EQ(red.value(2, 1), 21);
  EXPECT_EQ(red.fit.validity.at(2, 1), kNearDiscontinuity);
}

}  // namespace
}  // namespace estimation
