#include "estimation/calibration/illumination_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "estimation/geometry/lens.h"
#include "tests/estimation/geometry/synthetic_frames.h"
#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::make_rig;
using testing::NormalDeviates;
using testing::SyntheticRig;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr std::array<double, 3> kSignal{0.2, 0.19, 0.17}, kBlack{4e-4, 3e-4, 2e-4};
constexpr double kReferenceMm = 1000;

struct Standard {
  Vec3 middle_mm{0, 0, 1000}, direction{0.2, 0.1, 1};
  double half_width_mm = 200, half_height_mm = 150;
  double noise_frac = 0.01, position_noise_mm = 0.05;
};

double true_vignetting(double column_px, double row_px) {
  const double x = (column_px - 511.5) / 512, y = (row_px - 383.5) / 512;
  const double r2 = (x - 0.1) * (x - 0.1) + y * y;
  return (1 - 0.25 * r2 + 0.04 * r2 * r2) / (1 - 0.25 * 0.01 + 0.04 * 1e-4);
}

// What the camera has of the standard on a dark wall behind it.
class SeenStandard {
 public:
  SeenStandard(const SyntheticRig& rig, const Standard& standard, double reflectance) {
    const int height = rig.camera.height_px, width = rig.camera.width_px;
    for (Image<float>* image :
         {&white_, &black_, &column_, &row_, &position_[0], &position_[1], &position_[2]})
      *image = Image<float>(height, width, 1, kNaN);
    const Vec3 centre =
        -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
    const auto on_standard = testing::plane(standard.middle_mm, standard.direction);
    const auto on_wall = testing::plane({0, 0, 1400}, {0, 0, 1});
    NormalDeviates deviates(5);
    const LensModel lens(rig.calibration.camera);
    for (int row = 0; row < height; ++row)
      for (int col = 0; col < width; ++col) {
        const Vec2 seen =
            lens.unimage({static_cast<double>(col), static_cast<double>(row)})->normalized;
        const Vec3 direction(seen[0], seen[1], 1);
        Vec3 point = direction * *on_standard.depth_mm(direction);
        const Vec3 off = point - standard.middle_mm;
        const bool is_standard =
            std::abs(off[0]) < standard.half_width_mm && std::abs(off[1]) < standard.half_height_mm;
        if (!is_standard) point = direction * *on_wall.depth_mm(direction);
        const Vec3 normal = is_standard ? on_standard.normal(point) : Vec3(0, 0, -1);
        const cv::Vec2d lit = testing::projector_pixel(rig, point);
        if (lit[0] < 0 || lit[0] > 1023 || lit[1] < 0 || lit[1] > 767) continue;
        const Vec3 to = centre - point;
        const double distance = cv::norm(to);
        const double gain = normal.dot(to) / distance * std::pow(kReferenceMm / distance, 2) *
                            (is_standard ? reflectance : 0.1);
        const auto band = static_cast<std::size_t>(band_at(rig.camera, row, col));
        white_.at(row, col) =
            static_cast<float>(gain * kSignal[band] * true_vignetting(lit[0], lit[1]) *
                               (1 + standard.noise_frac * deviates.next()));
        black_.at(row, col) = static_cast<float>(gain * kBlack[band]);
        column_.at(row, col) = static_cast<float>(lit[0]);
        row_.at(row, col) = static_cast<float>(lit[1]);
        for (int axis = 0; axis < 3; ++axis)
          position_[static_cast<std::size_t>(axis)].at(row, col) =
              static_cast<float>(point[axis] + standard.position_noise_mm * deviates.next());
      }
  }
  StandardView view() const {
    return {white_.view(),
            black_.view(),
            column_.view(),
            row_.view(),
            {position_[0].view(), position_[1].view(), position_[2].view()}};
  }

 private:
  Image<float> white_, black_, column_, row_;
  std::array<Image<float>, 3> position_;
};

SyntheticRig bayer_rig() {
  SyntheticRig rig = make_rig(392, 288, true);
  rig.camera.pixel_format = {ColorFilter::kBayerRG, 12};
  return rig;
}

TEST(IlluminationFit, ConstantsToHalfAPercentAndTheVignetting) {
  const SyntheticRig rig = bayer_rig();
  const SeenStandard seen(rig, {}, 0.98);
  const StandardView view = seen.view();
  const auto fit = fit_illumination(std::span(&view, 1), rig.calibration, rig.camera, rig.projector,
                                    {.reflectance = {0.98, 0.98, 0.98}});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->order, 4);
  EXPECT_THAT(fit->warnings, IsEmpty());
  for (std::size_t band = 0; band < 3; ++band) {
    const double found =
        fit->signal_per_us[band].value * std::pow(fit->reference_distance_mm / kReferenceMm, 2);
    std::printf("band %zu: signal off by %.3f%% (sd %.3f%%), black %.6f\n", band,
                100 * (found / kSignal[band] - 1),
                100 * fit->signal_per_us[band].sd / fit->signal_per_us[band].value,
                fit->projector_black_dn_per_us[band].value);
    EXPECT_NEAR(found / kSignal[band], 1, 0.005);
    // Without vignetting: it is a constant in the session.
    EXPECT_NEAR(fit->projector_black_dn_per_us[band].value *
                    std::pow(fit->reference_distance_mm / kReferenceMm, 2) / kBlack[band],
                1, 0.005);
  }
  for (const int row : {100, 383, 650})
    for (const int col : {120, 511, 900})
      EXPECT_NEAR(static_cast<double>(fit->vignetting.at(row, col)), true_vignetting(col, row),
                  0.005)
          << row << " " << col;
}

TEST(IlluminationFit, SeveralPlacesOfASmallStandard) {
  const SyntheticRig rig = bayer_rig();
  std::vector<SeenStandard> seen;
  for (const double x : {-75.0, 0.0, 75.0})
    for (const double y : {-55.0, 0.0, 55.0}) {
      Standard standard;
      standard.half_width_mm = standard.half_height_mm = 40;
      standard.middle_mm = {x, y, 1000 + x / 5};
      seen.emplace_back(rig, standard, 0.99);
    }
  std::vector<StandardView> views;
  for (const SeenStandard& one : seen) views.push_back(one.view());
  const auto fit = fit_illumination(views, rig.calibration, rig.camera, rig.projector, {});
  ASSERT_TRUE(fit) << fit.error().text();
  for (std::size_t band = 0; band < 3; ++band)
    EXPECT_NEAR(fit->signal_per_us[band].value *
                    std::pow(fit->reference_distance_mm / kReferenceMm, 2) / kSignal[band],
                1, 0.005);
}

TEST(IlluminationFit, ASmallStandardAsideSaysWhatItCannotKnow) {
  const SyntheticRig rig = bayer_rig();
  Standard standard;
  standard.half_width_mm = standard.half_height_mm = 30;
  standard.middle_mm = {80, 40, 1000};
  const SeenStandard seen(rig, standard, 0.99);
  const StandardView view = seen.view();
  const auto fit =
      fit_illumination(std::span(&view, 1), rig.calibration, rig.camera, rig.projector, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->order, 0);
  EXPECT_THAT(fit->warnings, Contains(HasSubstr("extrapolated")));
  EXPECT_THAT(fit->warnings, Contains(HasSubstr("small part")));
}

TEST(IlluminationFit, AnEmptyPictureIsRefused) {
  const SyntheticRig rig = bayer_rig();
  const Image<float> nothing(rig.camera.height_px, rig.camera.width_px, 1, kNaN);
  const StandardView view{nothing.view(),
                          {},
                          nothing.view(),
                          nothing.view(),
                          {nothing.view(), nothing.view(), nothing.view()}};
  const auto fit =
      fit_illumination(std::span(&view, 1), rig.calibration, rig.camera, rig.projector, {});
  ASSERT_FALSE(fit);
  EXPECT_THAT(fit.error().text(), HasSubstr("no bright plane"));
}

}  // namespace
}  // namespace estimation
