// Rigs that are not ours, ray-traced: a ball before a wall, so that there are cast shadows, places
// that only one device sees, and pixels that see both; eight bits, noise, ambient light, no dark
// frames.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "estimation/geometry/surface.h"
#include "tests/estimation/geometry/synthetic_frames.h"
#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

using testing::add_gray;
using testing::BlurredPattern;
using testing::NormalDeviates;
using testing::SyntheticRig;

const Vec3 kBallMm{10, -5, 960};
constexpr double kBallRadiusMm = 45;
constexpr double kWallMm = 1040;
constexpr int kSide = 3;  // rays along a pixel's side

struct Hit {
  Vec3 point_mm, normal;
  bool is_there = false;
};

Hit trace(const Vec3& from_mm, const Vec3& way) {
  const auto ball = testing::sphere(kBallMm - from_mm, kBallRadiusMm).depth_mm(way);
  if (ball && *ball > 1e-6) {
    const Vec3 point = from_mm + way * *ball;
    return {point, (point - kBallMm) / kBallRadiusMm, true};
  }
  const double wall = (kWallMm - from_mm[2]) / way[2];
  return {from_mm + way * wall, Vec3(0, 0, -1), wall > 0};
}

struct Ray {
  double column_px = 0, row_px = 0, light = 0;  // light 0: in shadow
  double depth_mm = 0;
};

// A camera pixel's rays, and what it is held against: all see one lit surface, all are dark, or
// neither.
struct Pixel {
  std::array<Ray, kSide * kSide> rays;
  bool is_clear = false, is_dark = false;
  Ray centre;
};

class Scene {
 public:
  explicit Scene(const SyntheticRig& rig) : rig_(rig) {
    projector_mm_ =
        -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
    pixels_.resize(static_cast<std::size_t>(rig.camera.width_px * rig.camera.height_px));
    tbb::parallel_for(0, rig.camera.height_px, [&](int row) {
      for (int col = 0; col < rig.camera.width_px; ++col) pixel(row, col) = look(row, col);
    });
  }

  // Frames of eight bits: 12 DN of offset and ambient light nobody measured.
  std::vector<Image<float>> frames(const std::vector<PatternKind>& kinds, double white_dn) const {
    std::vector<Image<float>> frames(kinds.size());
    tbb::parallel_for(std::size_t{0}, kinds.size(), [&](std::size_t i) {
      const Axis axis = testing::axis_of(kinds[i]);
      const bool is_flat =
          std::holds_alternative<White>(kinds[i]) || std::holds_alternative<Black>(kinds[i]);
      const BlurredPattern pattern(
          is_flat ? PatternKind(GrayCode{}) : kinds[i], 0.6,
          axis == Axis::kColumn ? rig_.projector.width_px : rig_.projector.height_px);
      NormalDeviates deviates(100 + i);
      frames[i] = Image<float>(rig_.camera.height_px, rig_.camera.width_px);
      for (int row = 0; row < rig_.camera.height_px; ++row)
        for (int col = 0; col < rig_.camera.width_px; ++col) {
          double sum = 0;
          for (const Ray& ray : at(row, col).rays) {
            const double shown =
                std::holds_alternative<White>(kinds[i]) ? 1
                : std::holds_alternative<Black>(kinds[i])
                    ? 0
                    : pattern.at(axis == Axis::kColumn ? ray.column_px : ray.row_px);
            sum += ray.light * (0.004 + shown);  // a projector's black is not black
          }
          const double dn = 12 + white_dn * sum / (kSide * kSide);
          const double sd = std::sqrt(0.25 + dn / 40);
          frames[i].at(row, col) =
              static_cast<float>(std::clamp(std::round(dn + sd * deviates.next()), 0.0, 255.0));
        }
    });
    return frames;
  }

  const Pixel& at(int row, int col) const {
    return pixels_[static_cast<std::size_t>(row * rig_.camera.width_px + col)];
  }

 private:
  Pixel& pixel(int row, int col) {
    return pixels_[static_cast<std::size_t>(row * rig_.camera.width_px + col)];
  }

  Ray cast(double row, double col) const {
    const Mat3& K = rig_.calibration.camera.K;
    const Hit hit = trace({}, {(col - K(0, 2)) / K(0, 0), (row - K(1, 2)) / K(1, 1), 1});
    const auto lit = testing::projector_pixel(rig_, hit.point_mm);
    const Vec3 to_projector = projector_mm_ - hit.point_mm;
    const Vec3 way = to_projector / cv::norm(to_projector);
    const Hit met = trace(projector_mm_, -way);
    const bool is_lit = cv::norm(met.point_mm - hit.point_mm) < 0.01 && lit[0] > -0.5 &&
                        lit[1] > -0.5 && lit[0] < rig_.projector.width_px - 0.5 &&
                        lit[1] < rig_.projector.height_px - 0.5;
    return {lit[0], lit[1], is_lit ? std::max(0.0, hit.normal.dot(way)) : 0, hit.point_mm[2]};
  }

  Pixel look(int row, int col) const {
    Pixel pixel;
    double nearest = 1e9, farthest = 0;
    int lit_count = 0;
    for (int i = 0; i < kSide * kSide; ++i) {
      const Ray ray =
          cast(row + (i / kSide - 1) / double{kSide}, col + (i % kSide - 1) / double{kSide});
      nearest = std::min(nearest, ray.depth_mm);
      farthest = std::max(farthest, ray.depth_mm);
      lit_count += ray.light > 0 ? 1 : 0;
      pixel.rays[static_cast<std::size_t>(i)] = ray;
    }
    pixel.centre = cast(row, col);
    pixel.is_clear =
        lit_count == kSide * kSide && farthest - nearest < 5 && pixel.centre.light > 0.3;
    pixel.is_dark = lit_count == 0;
    return pixel;
  }

  const SyntheticRig& rig_;
  Vec3 projector_mm_;
  std::vector<Pixel> pixels_;
};

struct Outcome {
  double decoded_frac = 0;  // of clear pixels
  double outlier_frac = 0;  // of what is decoded, mixed pixels and all: beyond 2 px
  double dark_frac = 0;     // of pixels in shadow that have a value
  double rms_px = 0;        // of the clear pixels' inliers
  double median_depth_error_mm = 0;
};

Outcome outcome_of(const SyntheticRig& rig, const Scene& scene,
                   const std::vector<PatternKind>& kinds, double white_dn = 150) {
  const std::vector<Image<float>> frames = scene.frames(kinds, white_dn);
  std::vector<PatternSignal> signals;
  for (std::size_t i = 0; i < kinds.size(); ++i) signals.push_back({&kinds[i], frames[i].view()});
  CorrespondenceOptions options;
  options.noise = {{std::numeric_limits<double>::infinity(), 0.25 + 1.0 / 12, 1.0 / 40}};
  const Correspondence found = decode_correspondence(signals, rig.projector, options);
  EXPECT_FALSE(found.column_px.empty());
  if (found.column_px.empty()) return {};
  const Surface surface =
      reconstruct_surface(rig.calibration, rig.camera, rig.projector, found, {});
  int clear = 0, decoded = 0, valid = 0, outliers = 0, dark = 0, false_light = 0;
  double squares = 0;
  std::vector<double> depth_errors_mm;
  for (int row = 0; row < rig.camera.height_px; ++row)
    for (int col = 0; col < rig.camera.width_px; ++col) {
      const Pixel& pixel = scene.at(row, col);
      const bool is_valid = !(surface.validity.at(row, col) & kValidityErrors);
      clear += pixel.is_clear ? 1 : 0;
      dark += pixel.is_dark ? 1 : 0;
      if (!is_valid) continue;
      ++valid;
      if (pixel.is_dark) {
        ++false_light;
        continue;
      }
      const double error_px = double{found.column_px.at(row, col)} - pixel.centre.column_px;
      // A mixed pixel may have the coordinate of any of its rays.
      double nearest_px = std::abs(error_px);
      for (const Ray& ray : pixel.rays)
        if (ray.light > 0)
          nearest_px =
              std::min(nearest_px, std::abs(double{found.column_px.at(row, col)} - ray.column_px));
      if (nearest_px > 2) {
        ++outliers;
        continue;
      }
      if (!pixel.is_clear) continue;
      ++decoded;
      squares += error_px * error_px;
      depth_errors_mm.push_back(
          std::abs(double{surface.position_mm[2].at(row, col)} - pixel.centre.depth_mm));
    }
  std::sort(depth_errors_mm.begin(), depth_errors_mm.end());
  const auto frac = [](int part, int whole) { return static_cast<double>(part) / whole; };
  return {frac(decoded, clear), frac(outliers, valid), frac(false_light, std::max(dark, 1)),
          std::sqrt(squares / decoded),
          depth_errors_mm.empty() ? 1e9 : depth_errors_mm[depth_errors_mm.size() / 2]};
}

SyntheticRig rig_with(int projector_width_px, int projector_height_px) {
  SyntheticRig rig = testing::make_rig(256, 144, false);
  const double scale = projector_width_px / 1024.0;
  rig.projector = {projector_width_px, projector_height_px, {}};
  rig.calibration.projector.K = Mat3(3000 * scale, 0, (projector_width_px - 1) / 2.0, 0,
                                     3000 * scale, (projector_height_px - 1) / 2.0, 0, 0, 1);
  return rig;
}

void add_fringes(std::vector<PatternKind>& kinds, Axis axis, double period_px, int steps) {
  for (int i = 0; i < steps; ++i) kinds.push_back(Fringe{axis, period_px, period_px * i / steps});
}

void expect_sound(const Outcome& outcome, double most_rms_px, double most_depth_mm) {
  std::printf("decoded %.4f outliers %.5f in shadow %.5f rms %.4f px depth %.3f mm\n",
              outcome.decoded_frac, outcome.outlier_frac, outcome.dark_frac, outcome.rms_px,
              outcome.median_depth_error_mm);
  EXPECT_GT(outcome.decoded_frac, 0.98);
  EXPECT_LT(outcome.outlier_frac, 0.001);
  EXPECT_LT(outcome.dark_frac, 0.002);
  EXPECT_LT(outcome.rms_px, most_rms_px);
  EXPECT_LT(outcome.median_depth_error_mm, most_depth_mm);
}

TEST(OtherRigs, GrayCodeWithInversesOnBothAxes) {
  const SyntheticRig rig = rig_with(1024, 768);
  const Scene scene(rig);
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 0);
  add_gray(kinds, Axis::kRow, 9, 0);
  expect_sound(outcome_of(rig, scene, kinds), 0.4, 0.4);
}

TEST(OtherRigs, GrayCodeAgainstWhiteAndBlackOnASmallProjector) {
  const SyntheticRig rig = rig_with(854, 480);
  const Scene scene(rig);
  std::vector<PatternKind> kinds{White{}, Black{}};
  add_gray(kinds, Axis::kColumn, 9, 0, false);
  expect_sound(outcome_of(rig, scene, kinds), 0.4, 0.5);
}

TEST(OtherRigs, ThreeStepsOfThreePeriodsWithoutGrayCode) {
  const SyntheticRig rig = rig_with(1280, 800);
  const Scene scene(rig);
  std::vector<PatternKind> kinds;
  // Periods whose beats tell 1280 columns apart.
  for (const double period_px : {1280 / 59.0, 1280 / 64.0, 1280 / 70.0})
    add_fringes(kinds, Axis::kColumn, period_px, 3);
  expect_sound(outcome_of(rig, scene, kinds), 0.2, 0.3);
}

TEST(OtherRigs, FourStepsOfOnePeriodWithGrayCodeAlongRows) {
  const SyntheticRig rig = rig_with(1024, 768);
  const Scene scene(rig);
  std::vector<PatternKind> kinds;
  add_fringes(kinds, Axis::kColumn, 32, 4);
  add_gray(kinds, Axis::kColumn, 9, 4);
  add_fringes(kinds, Axis::kRow, 24, 4);
  add_gray(kinds, Axis::kRow, 9, 3);
  expect_sound(outcome_of(rig, scene, kinds), 0.25, 0.3);
}

TEST(OtherRigs, OverexposedOnTheBall) {
  const SyntheticRig rig = rig_with(1024, 768);
  const Scene scene(rig);
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 0);
  add_fringes(kinds, Axis::kColumn, 16, 4);
  // Clipped at 255 without a saturation level that says so.
  const Outcome outcome = outcome_of(rig, scene, kinds, 300);
  EXPECT_GT(outcome.decoded_frac, 0.95);
  EXPECT_LT(outcome.outlier_frac, 0.001);
}

}  // namespace
}  // namespace estimation
