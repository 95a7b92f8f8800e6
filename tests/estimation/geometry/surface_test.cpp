#include "estimation/geometry/surface.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "estimation/geometry/smoothing.h"
#include "tests/estimation/geometry/synthetic_frames.h"
#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

using testing::make_rig;
using testing::NormalDeviates;
using testing::plane;
using testing::projector_pixel;
using testing::sphere;
using testing::SyntheticRig;
using testing::SyntheticSurface;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr double kDegree = 3.14159265358979323846 / 180;

struct Truth {
  Correspondence correspondence;
  Image<double> depth_mm;
  std::vector<Vec3> position_mm, normal;  // [row * width + col]
};

Vec3 camera_ray(const SyntheticRig& rig, int row, int col) {
  std::vector<cv::Point2d> normalized;
  const std::vector<cv::Point2d> pixels{
      {col + double(rig.camera.roi_x_px), row + double(rig.camera.roi_y_px)}};
  const auto& lens = rig.calibration.camera;
  cv::undistortPoints(
      pixels, normalized, cv::Mat(lens.K),
      std::vector<double>(lens.distortion.begin(), lens.distortion.end()), cv::noArray(),
      cv::noArray(), cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 100, 1e-14));
  return {normalized[0].x, normalized[0].y, 1};
}

// What a perfect decoder would have found, plus noise of sd_px.
Truth look_at(const SyntheticRig& rig, const SyntheticSurface& surface, double sd_px,
              bool with_rows) {
  const int height = rig.camera.height_px, width = rig.camera.width_px;
  Truth truth;
  Correspondence& found = truth.correspondence;
  found.validity = Image<std::uint32_t>(height, width);
  found.column_px = found.column_sd_px = Image<float>(height, width, 1, kNaN);
  if (with_rows) found.row_px = found.row_sd_px = found.column_px;
  truth.depth_mm = Image<double>(height, width);
  truth.position_mm.resize(found.validity.samples().size());
  truth.normal.resize(found.validity.samples().size());
  NormalDeviates deviates(5);
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      const Vec3 ray = camera_ray(rig, row, col);
      const auto depth_mm = surface.depth_mm(ray);
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                     static_cast<std::size_t>(col);
      if (!depth_mm) {
        found.validity.at(row, col) = kBackground;
        continue;
      }
      truth.depth_mm.at(row, col) = *depth_mm;
      truth.position_mm[i] = ray * *depth_mm;
      truth.normal[i] = surface.normal(truth.position_mm[i]);
      const auto lit = projector_pixel(rig, truth.position_mm[i]);
      found.column_px.at(row, col) = static_cast<float>(lit[0] + sd_px * deviates.next());
      found.column_sd_px.at(row, col) = static_cast<float>(sd_px);
      if (!with_rows) continue;
      found.row_px.at(row, col) = static_cast<float>(lit[1] + 0.2 * deviates.next());
      found.row_sd_px.at(row, col) = 0.2F;
    }
  }
  return truth;
}

Surface reconstruct(const SyntheticRig& rig, const Truth& truth, const SurfaceOptions& options) {
  return reconstruct_surface(rig.calibration, rig.camera, rig.projector, truth.correspondence,
                             options);
}

Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col) {
  return {double{image[0].at(row, col)}, double{image[1].at(row, col)},
          double{image[2].at(row, col)}};
}

double angle_rad(const Vec3& a, const Vec3& b) {
  return std::atan2(cv::norm(a.cross(b)), a.dot(b));
}

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

struct Errors {
  std::vector<double> position_mm, normal_rad;
  double normalized_square_sum = 0;       // of the error along the ray over its sd
  double normalized_tilt_square_sum = 0;  // of the normal's about either axis over its sd
};

// Over valid pixels, warned ones left out if asked.
Errors errors_of(const Surface& surface, const Truth& truth, bool without_warnings) {
  Errors errors;
  const int width = surface.validity.width_px();
  for (int row = 0; row < surface.validity.height_px(); ++row) {
    for (int col = 0; col < width; ++col) {
      const std::uint32_t validity = surface.validity.at(row, col);
      if ((validity & kValidityErrors) || (without_warnings && validity)) continue;
      const int pixel = row * width + col;
      const auto i = static_cast<std::size_t>(pixel);
      const Vec3 off = vector_at(surface.position_mm, row, col) - truth.position_mm[i];
      errors.position_mm.push_back(cv::norm(off));
      errors.normal_rad.push_back(angle_rad(vector_at(surface.normal, row, col), truth.normal[i]));
      errors.normalized_square_sum +=
          std::pow(cv::norm(off) / double{surface.position_sd_mm.at(row, col)}, 2);
      errors.normalized_tilt_square_sum +=
          std::pow(errors.normal_rad.back() / double{surface.tilt_sd_rad.at(row, col)}, 2) / 2;
    }
  }
  return errors;
}

TEST(Surface, APlaneIsExactWithAndWithoutDistortion) {
  for (const bool with_distortion : {false, true}) {
    SCOPED_TRACE(with_distortion);
    const SyntheticRig rig = make_rig(147, 108, with_distortion);
    const Truth truth = look_at(rig, plane({5, -3, 1010}, {0.3, -0.15, -1}), 1e-4, false);
    const Surface surface = reconstruct(rig, truth, {});
    const Errors errors = errors_of(surface, truth, false);
    ASSERT_EQ(errors.position_mm.size(), truth.position_mm.size());
    // Single-precision columns: 3e-5 px of rounding, smoothed.
    EXPECT_LT(quantile(errors.position_mm, 1), 2e-3);
    EXPECT_LT(quantile(errors.normal_rad, 1), 0.02 * kDegree);
  }
}

TEST(Surface, ASphereHasItsNormals) {
  const SyntheticRig rig = make_rig(294, 216, true);
  const Truth truth = look_at(rig, sphere({10, 0, 1080}, 90), 1e-4, true);
  const Surface surface = reconstruct(rig, truth, {});
  const Errors errors = errors_of(surface, truth, true);
  EXPECT_GT(errors.position_mm.size(), 8000U);
  EXPECT_LT(quantile(errors.position_mm, 0.99), 0.02);
  EXPECT_LT(quantile(errors.normal_rad, 0.5), 0.1 * kDegree);
  EXPECT_LT(quantile(errors.normal_rad, 0.99), 1.0 * kDegree);
  // The far wall was never seen: its pixels keep their reason.
  EXPECT_EQ(surface.validity.at(0, 0), std::uint32_t{kBackground});
  EXPECT_TRUE(std::isnan(surface.normal[0].at(0, 0)));
}

TEST(Surface, NormalsAreGoodToADegreeUnderNoiseAtBothResolutions) {
  for (const auto& [width, height] : {std::pair(588, 432), std::pair(1176, 300)}) {
    SCOPED_TRACE(width);
    const SyntheticRig rig = make_rig(width, height, false);
    const Truth truth = look_at(rig, sphere({0, 0, 1100}, 110), 0.03, true);
    const Surface surface = reconstruct(rig, truth, {});
    const Errors errors = errors_of(surface, truth, true);
    EXPECT_LT(quantile(errors.normal_rad, 0.5), 0.6 * kDegree);
    EXPECT_LT(quantile(errors.normal_rad, 0.95), 1.5 * kDegree);
    EXPECT_LT(quantile(errors.position_mm, 0.5), 0.03);
    const double normalized_rms =
        std::sqrt(errors.normalized_square_sum / static_cast<double>(errors.position_mm.size()));
    EXPECT_NEAR(normalized_rms, 1, 0.25);
    EXPECT_NEAR(std::sqrt(errors.normalized_tilt_square_sum /
                          static_cast<double>(errors.normal_rad.size())),
                1, 0.25);
  }
}

// A finite-difference check that shares nothing with the code: walk on the tangent plane until the
// projector's column (row) has changed, in the direction in which it changes fastest.
double pitch_by_walking(const SyntheticRig& rig, const Vec3& point, const Vec3& normal, int axis) {
  const Vec3 e1 = normal.cross(Vec3(0, 1, 0)) / cv::norm(normal.cross(Vec3(0, 1, 0)));
  const Vec3 e2 = normal.cross(e1);
  constexpr double kStep_mm = 0.01;
  const auto slope = [&](const Vec3& direction) {
    return (projector_pixel(rig, point + kStep_mm * direction)[axis] -
            projector_pixel(rig, point - kStep_mm * direction)[axis]) /
           (2 * kStep_mm);
  };
  return 1 / std::hypot(slope(e1), slope(e2));
}

TEST(Surface, PitchAnglesAndDistanceMatchFiniteDifferences) {
  const SyntheticRig rig = make_rig(147, 108, true);
  const Vec3 tilt(0.6, 0.2, -1);
  const Truth truth = look_at(rig, plane({0, 0, 1000}, tilt), 1e-4, true);
  const Surface surface = reconstruct(rig, truth, {});
  const Vec3 centre_mm =
      -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
  for (int row = 4; row < 108; row += 10) {
    for (int col = 4; col < 147; col += 10) {
      const auto i = static_cast<std::size_t>(row) * 147 + static_cast<std::size_t>(col);
      const Vec3& point = truth.position_mm[i];
      const Vec3& normal = truth.normal[i];
      const double column_mm = pitch_by_walking(rig, point, normal, 0);
      const double row_mm = pitch_by_walking(rig, point, normal, 1);
      EXPECT_NEAR(double{surface.column_pitch_mm.at(row, col)}, column_mm, 2e-4 * column_mm);
      EXPECT_NEAR(double{surface.row_pitch_mm.at(row, col)}, row_mm, 2e-4 * row_mm);
      const Vec3 to_projector = centre_mm - point;
      EXPECT_NEAR(double{surface.projector_distance_mm.at(row, col)}, cv::norm(to_projector), 0.01);
      EXPECT_NEAR(double{surface.cos_projector.at(row, col)},
                  normal.dot(to_projector) / cv::norm(to_projector), 1e-4);
      EXPECT_NEAR(double{surface.cos_camera.at(row, col)}, -normal.dot(point) / cv::norm(point),
                  1e-4);
      EXPECT_LT(surface.normal[2].at(row, col), 0);
    }
  }
}

// Each radius has its own sampling beside borders; the sphere's outline is one all around.
TEST(Surface, EveryRadiusFitsBesideBordersToo) {
  const SyntheticRig rig = make_rig(294, 216, false);
  const Truth truth = look_at(rig, sphere({10, 0, 1080}, 90), 1e-4, false);
  for (const double radius_mm : {0.5, 1.5, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0, 12.0}) {
    SCOPED_TRACE(radius_mm);
    SurfaceOptions options;
    options.smoothing_radius_mm = radius_mm;
    const Errors errors = errors_of(reconstruct(rig, truth, options), truth, false);
    EXPECT_GT(errors.position_mm.size(), 10000U);
    EXPECT_LT(quantile(errors.position_mm, 0.5), 0.02);
    EXPECT_LT(quantile(errors.normal_rad, 0.95), 6 * kDegree);
  }
}

TEST(Surface, AStepStaysSharpAndIsWarnedOf) {
  const SyntheticRig rig = make_rig(294, 216, false);
  SyntheticSurface step = plane({0, 0, 1000}, {0, 0, -1});
  step.depth_mm = [](const Vec3& ray) -> std::optional<double> { return ray[0] < 0 ? 1000 : 1015; };
  const Truth truth = look_at(rig, step, 0.02, true);
  const Surface surface = reconstruct(rig, truth, {});
  const Errors errors = errors_of(surface, truth, false);
  EXPECT_LT(quantile(errors.position_mm, 0.999), 0.15);
  EXPECT_LT(quantile(errors.normal_rad, 0.99), 4 * kDegree);
  const int edge = 147;  // the first column at ray[0] >= 0
  EXPECT_TRUE(surface.validity.at(100, edge) & kNearDiscontinuity);
  EXPECT_TRUE(surface.validity.at(100, edge - 1) & kNearDiscontinuity);
  EXPECT_EQ(surface.validity.at(100, edge - 20), 0U);
  EXPECT_EQ(surface.validity.at(100, edge + 20), 0U);
}

// Beside a cast shadow, unlit pixels see the light that comes out of their lit neighbours; a dark
// patch in the middle of the surface is a dark patch.
TEST(Surface, GlowBesideAShadowIsNoCorrespondenceAndADarkPatchIsOne) {
  const SyntheticRig rig = make_rig(294, 216, false);
  Truth truth = look_at(rig, plane({0, 0, 1000}, {0, 0, -1}), 0.02, true);
  const int shadow = 150, patch = 60, patch_end = 66;
  truth.correspondence.modulation_dn_per_us = Image<float>(216, 294, 1, 0.1F);
  for (int row = 0; row < 216; ++row) {
    for (int col = shadow; col < 200; ++col) {
      truth.correspondence.column_px.at(row, col) = kNaN;
      truth.correspondence.row_px.at(row, col) = kNaN;
      truth.correspondence.validity.at(row, col) = kBackground;
    }
    truth.correspondence.modulation_dn_per_us.at(row, shadow - 1) = 0.02F;
    truth.correspondence.modulation_dn_per_us.at(row, shadow - 2) = 0.05F;
    for (int col = patch; col < patch_end; ++col)
      truth.correspondence.modulation_dn_per_us.at(row, col) = 0.01F;
  }
  const Surface surface = reconstruct(rig, truth, {});
  EXPECT_EQ(surface.validity.at(100, shadow - 1), std::uint32_t{kNoCorrespondence});
  EXPECT_EQ(surface.validity.at(100, shadow - 2), std::uint32_t{kNearDiscontinuity});
  EXPECT_EQ(surface.validity.at(100, patch), 0U);
  SurfaceOptions options;
  options.glow_frac = 0;
  EXPECT_EQ(reconstruct(rig, truth, options).validity.at(100, shadow - 1),
            std::uint32_t{kNearDiscontinuity});
}

TEST(Surface, SingleLostPixelsDoNotDisturbTheirNeighbours) {
  const SyntheticRig rig = make_rig(588, 108, false);
  Truth truth = look_at(rig, plane({0, 0, 1000}, {0.2, 0, -1}), 0.02, false);
  for (int row = 5; row < 108; row += 9) {
    for (int col = 5; col < 588; col += 9) {
      truth.correspondence.column_px.at(row, col) = kNaN;
      truth.correspondence.column_sd_px.at(row, col) = kNaN;
      truth.correspondence.validity.at(row, col) = kSaturated;
    }
  }
  const Surface surface = reconstruct(rig, truth, {});
  EXPECT_EQ(surface.validity.at(50, 50), std::uint32_t{kSaturated});
  EXPECT_EQ(surface.validity.at(50, 51), 0U);
  const Errors errors = errors_of(surface, truth, false);
  EXPECT_LT(quantile(errors.position_mm, 0.99), 0.05);
}

// A Gray-code scanner in a room: whole columns, metres away, 4 mm a pixel.
TEST(Surface, CoarseReadingsFarAwayGiveASurfaceWithSmoothNormals) {
  const SyntheticRig rig = make_rig(300, 220, false);
  Truth truth = look_at(rig, plane({0, 0, 4000}, {0.1, 0.2, -1}), 0, true);
  for (Image<float>* position : {&truth.correspondence.column_px, &truth.correspondence.row_px})
    for (float& value : position->samples()) value = std::round(value);
  for (Image<float>* sd : {&truth.correspondence.column_sd_px, &truth.correspondence.row_sd_px})
    for (float& value : sd->samples()) value = 0.29F;
  const Errors errors = errors_of(reconstruct(rig, truth, {}), truth, false);
  EXPECT_EQ(errors.normal_rad.size(), truth.normal.size());
  EXPECT_LT(quantile(errors.normal_rad, 0.5) / kDegree, 6);
}

TEST(Surface, DisagreeingAxesAreNoCorrespondence) {
  const SyntheticRig rig = make_rig(147, 108, false);
  Truth truth = look_at(rig, plane({0, 0, 1000}, {0, 0, -1}), 0.02, true);
  truth.correspondence.row_px.at(40, 60) += 25;
  const Surface surface = reconstruct(rig, truth, {});
  EXPECT_EQ(surface.validity.at(40, 60), std::uint32_t{kNoCorrespondence});
  EXPECT_EQ(surface.validity.at(41, 61) & kValidityErrors, 0U);
}

TEST(Surface, TheSyncSquareIsLeftOutByColumnsAlone) {
  SyntheticRig rig = make_rig(147, 108, false);
  const Truth truth = look_at(rig, plane({0, 0, 1000}, {0, 0, -1}), 0.02, false);
  rig.projector.sync_square = SyncSquare{480, 360, 60, 40};
  const Surface surface = reconstruct(rig, truth, {});
  int inside_count = 0;
  for (int row = 0; row < 108; ++row)
    for (int col = 0; col < 147; ++col) {
      const auto lit =
          projector_pixel(rig, truth.position_mm[static_cast<std::size_t>(row * 147 + col)]);
      const double beyond = std::max({480 - lit[0], lit[0] - 539, 360 - lit[1], lit[1] - 399});
      const bool is_left_out = (surface.validity.at(row, col) & kNoCorrespondence) != 0;
      if (std::abs(beyond) <= 1) continue;
      EXPECT_EQ(is_left_out, beyond < 0) << row << ' ' << col;
      if (beyond < 0) ++inside_count;
    }
  EXPECT_GT(inside_count, 30);
}

TEST(Surface, GrazingLightIsNamed) {
  const SyntheticRig rig = make_rig(147, 108, false);
  // Seen at 70 degrees, lit at 84.
  const double tilt = 70 * kDegree;
  const Truth truth =
      look_at(rig, plane({0, 0, 1000}, {-std::sin(tilt), 0, -std::cos(tilt)}), 0.001, false);
  const Surface surface = reconstruct(rig, truth, {});
  EXPECT_EQ(surface.validity.at(54, 73) & kValidityErrors, std::uint32_t{kGrazingProjector});
  EXPECT_TRUE(std::isnan(surface.position_mm[2].at(54, 73)));
}

TEST(Surface, NoRadiusLeavesPositionsAsTriangulated) {
  const SyntheticRig rig = make_rig(147, 108, false);
  const Truth truth = look_at(rig, plane({0, 0, 1000}, {0.2, 0, -1}), 0.05, false);
  SurfaceOptions options;
  options.smoothing_radius_mm = 0;
  const Errors errors = errors_of(reconstruct(rig, truth, options), truth, false);
  const double rms =
      std::sqrt(errors.normalized_square_sum / static_cast<double>(errors.position_mm.size()));
  EXPECT_NEAR(rms, 1, 0.05);
}

// A camera so coarse that no window is wanted: its slopes are those of cubics, not off by a sixth
// of their third derivative.
TEST(Surface, SlopesOfACoarseCameraAreExactForCubics) {
  constexpr int kSide = 15, kMiddle = 7;
  Image<float> inverse_per_mm(kSide, kSide), relative_sd(kSide, kSide, 1, 1e-5F);
  for (int row = 0; row < kSide; ++row)
    for (int col = 0; col < kSide; ++col) {
      const double x = col - kMiddle, y = row - kMiddle;
      inverse_per_mm.at(row, col) = static_cast<float>(1e-3 + 4e-6 * x - 3e-6 * y + 2e-7 * x * y +
                                                       6e-8 * x * x * x - 5e-8 * y * y * y);
    }
  FitRow middle;
  fit_locally({inverse_per_mm.view(), relative_sd.view()}, {.radius_px = 0},
              [&](int row, const FitRow& fit) {
                if (row == kMiddle) middle = fit;
              });
  EXPECT_FLOAT_EQ(middle.inverse_depth_per_mm[kMiddle], 1e-3F);
  EXPECT_NEAR(double{middle.by_col[kMiddle]} / 4e-6, 1, 1e-3);
  EXPECT_NEAR(double{middle.by_row[kMiddle]} / -3e-6, 1, 1e-3);
  EXPECT_NEAR(double{middle.by_col[kMiddle + 3]} / (4e-6 + 3 * 6e-8 * 9), 1, 1e-3);
}

// Where a border cuts the few points of a normal's window, least squares are a plane's: a twentieth
// of these normals was 3.9 degrees off and more, and errors were 24 times what was stated.
TEST(Surface, ACoarseSpheresRimStatesItsNormalsErrors) {
  const SyntheticRig rig = make_rig(66, 48, false);
  const Truth truth = look_at(rig, sphere({10, 0, 1080}, 100), 0.01, true);
  const Errors errors = errors_of(reconstruct(rig, truth, {}), truth, false);
  const auto count = static_cast<double>(errors.normal_rad.size());
  EXPECT_GT(count, 800);
  EXPECT_LT(std::sqrt(errors.normalized_tilt_square_sum / count), 3);
  EXPECT_LT(quantile(errors.normal_rad, 0.95), 2.2 * kDegree);
}

TEST(Surface, SameBitsForAnyNumberOfThreads) {
  const SyntheticRig rig = make_rig(294, 216, true);
  const Truth truth = look_at(rig, sphere({10, 0, 1080}, 90), 0.02, true);
  const auto run = [&](std::size_t thread_count) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism,
                                            thread_count);
    return reconstruct(rig, truth, {});
  };
  const Surface one = run(1), four = run(4);
  const auto same_bits = [](const Image<float>& a, const Image<float>& b) {
    return std::equal(a.samples().begin(), a.samples().end(), b.samples().begin(),
                      [](float x, float y) {
                        return std::bit_cast<std::uint32_t>(x) == std::bit_cast<std::uint32_t>(y);
                      });
  };
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_TRUE(same_bits(one.position_mm[i], four.position_mm[i]));
    EXPECT_TRUE(same_bits(one.normal[i], four.normal[i]));
  }
  EXPECT_TRUE(same_bits(one.column_pitch_mm, four.column_pitch_mm));
}

}  // namespace
}  // namespace estimation
