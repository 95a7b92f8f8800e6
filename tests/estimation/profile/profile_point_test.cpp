// Which points' profiles are kept.
#include "estimation/profile/profile_point.h"

#include <gtest/gtest.h>

#include <utility>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

// 41 x 21 px, nothing valid yet.
struct Field {
  CameraInfo camera;
  std::array<Image<std::uint32_t>, 3> validity;

  explicit Field(ColorFilter filter = ColorFilter::kMono) {
    camera.width_px = 41;
    camera.height_px = 21;
    camera.pixel_format = {filter, 12};
    for (int band = 0; band < band_count(filter); ++band)
      validity[static_cast<std::size_t>(band)] = Image<std::uint32_t>(21, 41, 1, kBackground);
  }
  void set(int row, int col, std::uint32_t value) {
    for (Image<std::uint32_t>& band : validity)
      if (!band.empty()) band.at(row, col) = value;
  }
  void set_all(std::uint32_t value) {
    for (int row = 0; row < camera.height_px; ++row)
      for (int col = 0; col < camera.width_px; ++col) set(row, col, value);
  }
  std::vector<std::pair<int, int>> places() const {
    std::vector<std::pair<int, int>> places;
    for (const ProfilePoint& point : choose_profile_points(camera, validity))
      places.emplace_back(point.row, point.col);
    return places;
  }
};

using Places = std::vector<std::pair<int, int>>;

TEST(ProfilePoints, LieInTheMiddleOfTheQuadrantsOfWhatIsValid) {
  Field field;
  field.set_all(0);
  EXPECT_EQ(field.places(), (Places{{5, 10}, {5, 30}, {15, 10}, {15, 30}}));
  field.set_all(kBackground);
  for (int row = 4; row <= 12; ++row)
    for (int col = 20; col <= 36; ++col) field.set(row, col, kPoorFit);  // a warning is valid
  EXPECT_EQ(field.places(), (Places{{6, 24}, {6, 32}, {10, 24}, {10, 32}}));
}

TEST(ProfilePoints, AvoidInvalidPixelsOfAnyBandAndTakeTheFirstOfEquals) {
  Field field(ColorFilter::kRgb);
  field.set_all(0);
  field.validity[2].at(5, 10) = kTooDark;
  EXPECT_EQ(field.places(), (Places{{4, 10}, {5, 30}, {15, 10}, {15, 30}}));
}

TEST(ProfilePoints, AreFewerWhereThereAreFewPixels) {
  Field field;
  EXPECT_TRUE(field.places().empty());
  field.set(7, 9, 0);
  EXPECT_EQ(field.places(), (Places{{7, 9}}));
  field.set(9, 30, 0);
  EXPECT_EQ(field.places(), (Places{{7, 9}, {9, 30}}));
}

TEST(ProfilePoints, EachBandOfAMosaicHasItsOwnNearestValidSite) {
  Field field(ColorFilter::kBayerRG);
  field.set_all(0);
  field.validity[2].at(5, 9) = kSaturated;  // the blue site beside (5, 10)
  const auto points = choose_profile_points(field.camera, field.validity);
  ASSERT_EQ(points.size(), 4U);
  const std::array<ProfileBand, 3>& bands = points[0].bands;
  ASSERT_EQ(std::pair(points[0].row, points[0].col), std::pair(5, 10));
  EXPECT_EQ(std::pair(bands[0].row, bands[0].col), std::pair(4, 10));
  EXPECT_EQ(std::pair(bands[1].row, bands[1].col), std::pair(5, 10));
  EXPECT_EQ(std::pair(bands[2].row, bands[2].col), std::pair(5, 11));
}

}  // namespace
}  // namespace estimation
