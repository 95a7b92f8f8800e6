// The reference session written by another program: a plane tilted by 12 degrees about the y axis
// through (0, 0, 1000) mm, so the truth is that plane (design README of the reference data); what
// the projector sees of it is computed here by OpenCV.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "estimation/geometry/surface.h"
#include "estimation/radiometry/merge.h"
#include "estimation/session/frame_io.h"
#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180;
const std::filesystem::path kSession = SSRIG_SESSION_EXAMPLE;

struct Example {
  Manifest manifest;
  std::vector<Image<float>> merged;  // [pattern]
};

Example read_example() {
  Example example;
  auto manifest = read_manifest(kSession);
  EXPECT_TRUE(manifest) << manifest.error().text();
  example.manifest = *std::move(manifest);
  for (const Pattern& pattern : example.manifest.patterns) {
    std::vector<Image<std::uint16_t>> frames;
    std::vector<double> exposures_us;
    for (const FrameRecord& record : example.manifest.frames) {
      if (record.pattern != pattern.index) continue;
      auto frame = read_frame(kSession, example.manifest, record.file);
      EXPECT_TRUE(frame) << frame.error().text();
      frames.push_back(*std::move(frame));
      exposures_us.push_back(record.exposure_us);
    }
    std::vector<ExposedFrame> exposed;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      exposed.push_back({exposures_us[i], std::as_const(frames[i]).view()});
    }
    example.merged.push_back(
        merge_brackets(exposed, CameraBlack(*example.manifest.camera.black_level_dn),
                       *example.manifest.camera.saturation_level_dn, ImageView<const float>()));
  }
  return example;
}

// Signals of the patterns that `is_used` wants.
template <typename Predicate>
std::vector<PatternSignal> signals_of(const Example& example, const Predicate& is_used) {
  std::vector<PatternSignal> signals;
  for (std::size_t i = 0; i < example.merged.size(); ++i) {
    const PatternKind& kind = example.manifest.patterns[i].kind;
    if (is_used(kind)) signals.push_back({&kind, example.merged[i].view()});
  }
  return signals;
}

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

struct Errors {
  std::vector<double> column_px, column_normalized, position_mm, normal_rad;
  int outlier_count = 0;
};

Errors decode_and_compare(const Example& example, std::span<const PatternSignal> signals) {
  const Manifest& manifest = example.manifest;
  CorrespondenceOptions options;
  options.noise = merged_noise({16667, 66667}, {4.88, 10}, 4000 - 64);
  const auto found = decode_correspondence(signals, manifest.projector, options);
  const auto surface =
      reconstruct_surface(manifest.calibration, manifest.camera, manifest.projector, found, {});
  const Vec3 normal(-std::sin(12 * kDegree), 0, -std::cos(12 * kDegree));
  const testing::SyntheticSurface plane = testing::plane({0, 0, 1000}, normal);
  const testing::SyntheticRig rig{manifest.calibration, manifest.camera, manifest.projector};
  const Mat3& K = manifest.calibration.camera.K;
  Errors errors;
  for (int row = 0; row < manifest.camera.height_px; ++row) {
    for (int col = 0; col < manifest.camera.width_px; ++col) {
      if (surface.validity.at(row, col) & kValidityErrors) continue;
      const Vec3 ray((col - K(0, 2)) / K(0, 0), (row - K(1, 2)) / K(1, 1), 1);
      const Vec3 point = ray * *plane.depth_mm(ray);
      const auto at = [&](const std::array<Image<float>, 3>& image) {
        return Vec3(double{image[0].at(row, col)}, double{image[1].at(row, col)},
                    double{image[2].at(row, col)});
      };
      const double lit_px = testing::projector_pixel(rig, point)[0];
      const double error_px = std::abs(double{found.column_px.at(row, col)} - lit_px);
      if (error_px > 1.5) ++errors.outlier_count;
      errors.column_px.push_back(error_px);
      errors.column_normalized.push_back(error_px / double{found.column_sd_px.at(row, col)});
      errors.position_mm.push_back(cv::norm(at(surface.position_mm) - point));
      errors.normal_rad.push_back(std::acos(std::min(1.0, at(surface.normal).dot(normal))));
    }
  }
  return errors;
}

TEST(SessionExample, ThePaperPlanGivesThePlane) {
  const Example example = read_example();
  const Errors errors =
      decode_and_compare(example, signals_of(example, [](const PatternKind&) { return true; }));
  // All but the leftmost of 64 columns, which the projector does not reach.
  EXPECT_EQ(errors.column_px.size(), 63U * 48U);
  EXPECT_EQ(errors.outlier_count, 0);
  EXPECT_LT(quantile(errors.column_px, 0.5), 0.012);
  EXPECT_LT(quantile(errors.column_px, 0.95), 0.035);
  EXPECT_NEAR(quantile(errors.column_normalized, 0.5), 0.674, 0.674 * 0.2);
  EXPECT_LT(quantile(errors.position_mm, 0.5), 0.015);
  EXPECT_LT(quantile(errors.position_mm, 0.95), 0.05);
  EXPECT_LT(quantile(errors.normal_rad, 0.5), 0.2 * kDegree);
}

TEST(SessionExample, ColumnsAloneWithoutLowBitsAndInversesDoAsWell) {
  const Example example = read_example();
  const Errors errors = decode_and_compare(
      example, signals_of(example, [](const PatternKind& kind) {
        if (const auto* code = std::get_if<GrayCode>(&kind)) {
          return code->axis == Axis::kColumn && code->bit >= 3 && !code->inverted;
        }
        return std::get<Stripes>(kind).axis == Axis::kColumn;
      }));
  EXPECT_EQ(errors.column_px.size(), 63U * 48U);
  EXPECT_EQ(errors.outlier_count, 0);
  EXPECT_LT(quantile(errors.position_mm, 0.5), 0.015);
}

TEST(SessionExample, FourFineStripesAloneAreHonestAboutTheirAliasing) {
  const Example example = read_example();
  const Errors errors =
      decode_and_compare(example, signals_of(example, [](const PatternKind& kind) {
                           const auto* stripes = std::get_if<Stripes>(&kind);
                           return !stripes || stripes->period_px == 16;
                         }));
  EXPECT_EQ(errors.column_px.size(), 63U * 48U);
  EXPECT_EQ(errors.outlier_count, 0);
  EXPECT_LT(quantile(errors.column_px, 0.95), 0.3);
  EXPECT_LT(quantile(errors.column_normalized, 0.95), 2);
}

}  // namespace
}  // namespace estimation
