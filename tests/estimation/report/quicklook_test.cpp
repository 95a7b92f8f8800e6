#include "estimation/report/quicklook.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "estimation/report/pictures.h"
#include "estimation/report/plot.h"
#include "tests/temporary_folder.h"

namespace estimation {
namespace {

using test_support::TemporaryFolder;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// An ellipse of skin-like values with a darker, less translucent lower part; NaN around it.
Maps face_maps(int height, int width, int band_count) {
  Maps maps;
  maps.height_px = height;
  maps.width_px = width;
  maps.band_count = band_count;
  constexpr std::array<float, 3> kSigmaA{0.06F, 0.18F, 0.26F}, kSigmaS{1.2F, 1.5F, 1.1F};
  const Image<float> nothing(height, width, 1, kNaN);
  maps.position_mm.fill(nothing);
  maps.normal.fill(nothing);
  for (int band = 0; band < band_count; ++band) {
    const auto b = static_cast<std::size_t>(band);
    for (BandMaps* map : {&maps.sigma_a_per_mm, &maps.sigma_s_prime_per_mm, &maps.translucency_mm,
                          &maps.diffuse_reflectance, &maps.indirect}) {
      (*map)[b] = nothing;
    }
    maps.validity[b] = Image<std::uint32_t>(height, width, 1, kBackground);
  }
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      const float y = 2.1F * (static_cast<float>(row) / static_cast<float>(height) - 0.5F);
      const float x = 2.6F * (static_cast<float>(col) / static_cast<float>(width) - 0.5F);
      const float bulge = 1 - x * x - y * y;
      if (bulge < 0) continue;
      const float z = std::sqrt(bulge);
      maps.position_mm[0].at(row, col) = 90 * x;
      maps.position_mm[1].at(row, col) = 110 * y;
      maps.position_mm[2].at(row, col) = 1050 - 80 * z;
      maps.normal[0].at(row, col) = x;
      maps.normal[1].at(row, col) = y;
      maps.normal[2].at(row, col) = -z;
      for (int band = 0; band < band_count; ++band) {
        const auto b = static_cast<std::size_t>(band);
        const bool is_lost = z < 0.25F;
        maps.validity[b].at(row, col) = is_lost
                                            ? std::uint32_t{kGrazingProjector}
                                            : (z < 0.35F ? std::uint32_t{kNearDiscontinuity} : 0U);
        if (is_lost) continue;
        const float stubble = y > 0.3F && std::abs(x) < 0.6F ? 2.0F : 1.0F;
        const float sigma_a =
            kSigmaA[b] * stubble * (1 + 0.15F * std::sin(9 * x) * std::cos(7 * y));
        const float sigma_s = kSigmaS[b] / stubble * (1 + 0.1F * std::cos(11 * x + 3 * y));
        maps.sigma_a_per_mm[b].at(row, col) = sigma_a;
        maps.sigma_s_prime_per_mm[b].at(row, col) = sigma_s;
        maps.translucency_mm[b].at(row, col) = 1 / std::sqrt(3 * sigma_a * (sigma_a + sigma_s));
        maps.diffuse_reflectance[b].at(row, col) = 0.6F - 1.1F * sigma_a;
        maps.indirect[b].at(row, col) = 0.03F * (1 - z) - 0.005F;
      }
    }
  }
  return maps;
}

// Bayer sites see the stripes a little apart: each band peaks elsewhere.
ProfilePoint profile_point(int row, int col, double width_px, double peak_px) {
  ProfilePoint point{.row = row, .col = col};
  for (std::size_t b = 0; b < 3; ++b) {
    ProfileBand& band = point.bands[b];
    band.peak_px = peak_px + static_cast<double>(b);
    band.diffuse_reflectance = 0.5 - 0.1 * static_cast<double>(b);
    band.translucency_mm = 0.4 * width_px / (1 + 0.3 * static_cast<double>(b));
    const auto value_at = [&](double shift_px) {
      const double x = std::remainder(shift_px - band.peak_px, 40) * 0.4 / band.translucency_mm;
      return 0.5 * band.diffuse_reflectance * std::exp(-std::abs(x)) + 0.01;
    };
    for (int shift = 0; shift < 40; ++shift) {
      band.measured.push_back(
          {static_cast<double>(shift), value_at(shift) * (1 + 0.04 * std::sin(5.0 * shift))});
      for (const double part : {0.0, 0.5})
        band.matched.push_back({shift + part, value_at(shift + part)});
    }
  }
  return point;
}

std::vector<ProfilePoint> four_points() {
  return {profile_point(120, 290, 5, 3.2), profile_point(210, 180, 6, 17),
          profile_point(300, 300, 7, 39.6), profile_point(350, 310, 3, 25.1)};
}

CameraInfo bayer_camera(int height, int width) {
  CameraInfo camera;
  camera.height_px = height;
  camera.width_px = width;
  camera.pixel_format = {ColorFilter::kBayerRG, 12};
  camera.black_level_dn = 64;
  camera.saturation_level_dn = 4000;
  return camera;
}

// A red ball on black under RGGB.
Image<std::uint16_t> red_frame(const CameraInfo& camera) {
  Image<std::uint16_t> dn(camera.height_px, camera.width_px, 1, 64);
  for (int row = 0; row < camera.height_px; ++row) {
    for (int col = 0; col < camera.width_px; ++col) {
      const double y = row - camera.height_px / 2.0, x = col - camera.width_px / 2.0;
      const bool is_lit = std::hypot(x, y) < camera.height_px / 2.5;
      if (!is_lit) continue;
      constexpr std::array<int, 3> kLevel{3000, 1200, 700};
      const auto band = static_cast<std::size_t>(band_at(camera, row, col));
      dn.at(row, col) = static_cast<std::uint16_t>(64 + kLevel[band]);
    }
  }
  return dn;
}

TEST(Quicklook, WritesEveryPictureThereIsDataFor) {
  const TemporaryFolder folder;
  const Maps maps = face_maps(432, 588, 3);
  const CameraInfo camera = bayer_camera(432, 588);
  const Image<std::uint16_t> dn = red_frame(camera);
  const QuicklookFrame frame{"frame_stripes", "stripes column 40/8 shift 0, 16.7 ms", dn.view()};
  const auto written =
      write_quicklook(folder.path(), maps, camera, std::span(&frame, 1), four_points());
  ASSERT_TRUE(written) << written.error().text();
  ASSERT_THAT(*written, SizeIs(10));
  for (const auto& path : *written) {
    SCOPED_TRACE(path);
    const cv::Mat picture = cv::imread(path.string());
    ASSERT_FALSE(picture.empty());
    EXPECT_GT(picture.rows, 432);
    EXPECT_GT(picture.cols, 588);
  }
}

TEST(Quicklook, LeavesOutWhatWasNotComputed) {
  Maps maps = face_maps(48, 64, 1);
  for (BandMaps* map : {&maps.sigma_a_per_mm, &maps.sigma_s_prime_per_mm, &maps.translucency_mm,
                        &maps.diffuse_reflectance, &maps.indirect}) {
    *map = {};
  }
  const TemporaryFolder temporary;
  const auto folder = temporary.path() / "report";  // which is made
  const auto written = write_quicklook(folder, maps, bayer_camera(48, 64), {}, {});
  ASSERT_TRUE(written) << written.error().text();
  EXPECT_THAT(*written,
              ElementsAre(folder / "normal.png", folder / "depth.png", folder / "validity.png"));
}

TEST(Quicklook, DrawsSmallLargeAndEmptyMaps) {
  for (const auto& [height, width] : {std::pair(48, 64), std::pair(863, 1176)}) {
    SCOPED_TRACE(width);
    Maps maps = face_maps(height, width, 3);
    for (float& value : maps.indirect[0].samples()) value = kNaN;
    maps.indirect[2] = maps.indirect[1] = maps.indirect[0];
    const TemporaryFolder folder;
    const auto written = write_quicklook(folder.path(), maps, bayer_camera(height, width), {}, {});
    ASSERT_TRUE(written) << written.error().text();
    EXPECT_THAT(*written, SizeIs(8));
  }
}

TEST(Quicklook, AMosaicKeepsItsColours) {
  const TemporaryFolder folder;
  const CameraInfo camera = bayer_camera(432, 588);
  const Image<std::uint16_t> dn = red_frame(camera);
  const QuicklookFrame frame{"frame", "a frame", dn.view()};
  Maps maps;
  const auto written = write_quicklook(folder.path(), maps, camera, std::span(&frame, 1), {});
  ASSERT_TRUE(written) << written.error().text();
  ASSERT_THAT(*written, SizeIs(1));
  const cv::Mat3b picture = cv::imread((*written)[0].string());
  const cv::Vec3b centre = picture(picture.rows / 2, picture.cols / 2);
  EXPECT_NEAR(centre[2], 255 * std::pow(3000.0 / 3936, 1 / 2.2), 3);
  EXPECT_NEAR(centre[1], 255 * std::pow(1200.0 / 3936, 1 / 2.2), 3);
  EXPECT_NEAR(centre[0], 255 * std::pow(700.0 / 3936, 1 / 2.2), 3);
}

TEST(Quicklook, AnUnwritableFolderIsOneClearError) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "file";
  std::ofstream(file) << "in the way";
  const auto written =
      write_quicklook(file / "report", face_maps(48, 64, 3), bayer_camera(48, 64), {}, {});
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
  EXPECT_THAT(written.error().text(), HasSubstr("report"));
}

// Mean column of what is painted in (nearly) `color` below the title and the legend; -1: nothing.
double mean_column(const plot::Canvas& canvas, const plot::Color& color) {
  double sum = 0, count = 0;
  for (int row = 50; row < canvas.rows; ++row)
    for (int col = 0; col < canvas.cols; ++col)
      if (cv::norm(canvas(row, col), color) < 10) {
        sum += col;
        ++count;
      }
  return count > 0 ? sum / count : -1;
}

TEST(Pictures, EachBandOfAProfileIsCentredOnItsOwnPeak) {
  ProfilePoint point;
  for (std::size_t b = 0; b < 3; ++b) {
    ProfileBand& band = point.bands[b];
    band.peak_px = std::array{38.25, 1.0, 7.5}[b];
    for (const double offset_px : {-2.0, 2.0})
      band.measured.push_back(
          {std::fmod(band.peak_px + offset_px + 40, 40), 0.1 + 0.1 * static_cast<double>(b)});
  }
  const plot::Canvas canvas = plot::draw_profiles(std::span(&point, 1), 3);
  const double red = mean_column(canvas, {45, 45, 205});
  EXPECT_GT(red, 0);
  EXPECT_NEAR(mean_column(canvas, {60, 150, 40}), red, 0.5);
  EXPECT_NEAR(mean_column(canvas, {200, 95, 30}), red, 0.5);
}

TEST(Pictures, TheLegendPromisesACurveOnlyWhereThereIsOne) {
  std::vector<ProfilePoint> points = four_points();
  const auto legend_ink = [&points] {
    const plot::Canvas canvas = plot::draw_profiles(points, 3);
    int ink = 0;
    for (int row = 0; row < 46; ++row)
      for (int col = canvas.cols / 2; col < canvas.cols; ++col)
        ink += canvas(row, col) != plot::kWhite;
    return ink;
  };
  const int with_curve = legend_ink();
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(legend_ink(), with_curve);  // one point's is enough
    for (ProfileBand& band : points[i].bands) band.matched.clear();
  }
  EXPECT_LT(legend_ink(), with_curve);
}

TEST(Plot, TicksAreRoundAndInside) {
  EXPECT_THAT(plot::nice_ticks({0, 1}, 5),
              ElementsAre(0, 0.2, 0.4, ::testing::DoubleNear(0.6, 1e-12), 0.8, 1));
  EXPECT_THAT(plot::nice_ticks({-0.031, 0.048}, 4),
              ElementsAre(::testing::DoubleNear(-0.02, 1e-12), 0, 0.02, 0.04));
  EXPECT_EQ(plot::tick_label(0.4, 0.2), "0.4");
  EXPECT_EQ(plot::tick_label(0, 0.2), "0");
  EXPECT_EQ(plot::tick_label(1020, 20), "1020");
  EXPECT_EQ(plot::tick_label(0.05, 0.05), "0.05");
}

TEST(Plot, RangeIgnoresOutliersAndMissingPixels) {
  Image<float> image(10, 100, 1, 0.5F);
  for (int col = 0; col < 100; ++col) image.at(3, col) = 0.7F;
  image.at(0, 0) = 1e6F;
  image.at(0, 1) = kNaN;
  const plot::Range range = plot::robust_range({image.view()}, 0.01, 0.99);
  EXPECT_NEAR(range.low, 0.5, 0.02);
  EXPECT_NEAR(range.high, 0.7, 0.02);
}

TEST(Plot, MissingPixelsAreGreyAndColoursFollowValues) {
  Image<float> image(1, 3);
  image.at(0, 0) = 0;
  image.at(0, 1) = 1;
  image.at(0, 2) = kNaN;
  const plot::Canvas canvas = plot::false_color(image.view(), {0, 1});
  EXPECT_EQ(canvas(0, 2), plot::kMissing);
  EXPECT_EQ(canvas(0, 0), plot::Color(84, 1, 68));     // viridis' dark end
  EXPECT_EQ(canvas(0, 1), plot::Color(37, 231, 253));  // and its bright one
}

TEST(Plot, ReducingAveragesAndKeepsBorders) {
  Image<float> image(4, 4, 1, 2);
  image.at(0, 0) = 4;
  for (int row = 0; row < 4; ++row) image.at(row, 3) = image.at(row, 2) = kNaN;
  const Image<float> half = plot::resize_for_panel(image.view(), 0.5);
  EXPECT_FLOAT_EQ(half.at(0, 0), 2.5F);
  EXPECT_TRUE(std::isnan(half.at(1, 1)));
}

}  // namespace
}  // namespace estimation
