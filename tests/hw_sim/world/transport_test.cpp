// Light transport against integrals that the test does itself, over the plane, in space.
#include "hw_sim/world/transport.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "tests/hw_sim/world/test_rig.h"

namespace hw_sim {
namespace {

using estimation::Image;
using estimation::Vec3;

// Female cheek, Table 2, by band: the phantom's material.
constexpr double kSigmaA[3] = {0.0525, 0.1653, 0.2216};
constexpr double kSigmaS[3] = {1.2814, 1.5, 1.1248};
constexpr double kPlaneZ = 1000;

// Eq. 3 of the paper, written down anew.
double kernel(double r2, double sigma_a, double sigma_s) {
  const double st = sigma_a + sigma_s, str = std::sqrt(3 * sigma_a * st);
  const double zr = 1 / st, zv = zr * (1 + 4.0 / 3.0 * (1 + 0.529489) / (1 - 0.529489));
  const double dr = std::sqrt(r2 + zr * zr), dv = std::sqrt(r2 + zv * zv);
  return sigma_s / st / (4 * std::numbers::pi) *
         (zr * (str + 1 / dr) * std::exp(-str * dr) / (dr * dr) +
          zv * (str + 1 / dv) * std::exp(-str * dv) / (dv * dv));
}

double total(std::size_t band) {
  const double albedo = kSigmaS[band] / (kSigmaA[band] + kSigmaS[band]);
  const double root = std::sqrt(3 * (1 - albedo));
  return albedo / 2 * (1 + std::exp(-4.0 / 3.0 * (1.529489 / 0.470511) * root)) * std::exp(-root);
}

struct Plane {
  TestRig rig;
  Vec3 lamp_mm() const {
    return -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
  }
  Vec3 point_at(int row, int col) const {
    const auto& K = rig.calibration.camera.K;
    return {(col - K(0, 2)) / K(0, 0) * kPlaneZ, (row - K(1, 2)) / K(1, 1) * kPlaneZ, kPlaneZ};
  }
  // cos(theta_i) (d0 / d)^2
  double gain(const Vec3& point) const {
    const Vec3 to_lamp = lamp_mm() - point;
    const double d = cv::norm(to_lamp), d0 = *rig.calibration.irradiance->reference_distance_mm;
    return -to_lamp[2] / d * (d0 / d) * (d0 / d);
  }
  double projector_col(const Vec3& point) const {
    const Vec3 local =
        rig.calibration.projector_from_camera * point + rig.calibration.projector_from_camera_mm;
    return rig.calibration.projector.K(0, 0) * local[0] / local[2] +
           rig.calibration.projector.K(0, 2);
  }
  double factor(const Image<float>& linear, int row, int col) const {  // signal over signal_per_us
    const auto band = static_cast<std::size_t>(estimation::band_at(rig.camera, row, col));
    return static_cast<double>(linear.at(row, col)) /
           rig.calibration.irradiance->signal_per_us[band];
  }
};

class FlatPhantom : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    plane_ = new Plane{make_test_rig(49, 36, 1)};
    SceneOptions options;
    options.name = "flat_phantom";
    options.has_indirect = false;
    options.thread_count = 2;
    world_ = make_world(plane_->rig, options).release();
  }
  static void TearDownTestSuite() {
    delete world_;
    delete plane_;
  }
  static Image<float> under(const estimation::PatternKind& kind) {
    return world_->linear_image(make_picture(plane_->rig, kind));
  }
  static Plane* plane_;
  static HeadWorld* world_;
};
Plane* FlatPhantom::plane_ = nullptr;
HeadWorld* FlatPhantom::world_ = nullptr;

TEST_F(FlatPhantom, FullyLitPlaneReflectsEquation5) {
  const Image<float> white = under(estimation::White{});
  int count = 0;
  for (int row = 8; row < 28; ++row)
    for (int col = 12; col < 37; ++col) {
      const auto band = static_cast<std::size_t>(estimation::band_at(plane_->rig.camera, row, col));
      const double r = plane_->factor(white, row, col) / plane_->gain(plane_->point_at(row, col));
      // The light's gradient over the kernel and its perspective are the rest.
      EXPECT_NEAR(r, total(band), 1e-3 * total(band)) << row << " " << col;
      ++count;
    }
  EXPECT_EQ(count, 500);
}

TEST_F(FlatPhantom, WhiteByRowsAndByColumnsAgree) {
  // One column darker by one step: no longer constant along columns, so its response to rows
  // serves black-and-white rows below.
  const Image<float> even = under(estimation::Stripes{estimation::Axis::kRow, 2, 1, 0});
  const Image<float> odd = under(estimation::Stripes{estimation::Axis::kRow, 2, 1, 1});
  const Image<float> white = under(estimation::White{});
  for (int row = 8; row < 28; ++row)
    for (int col = 12; col < 37; ++col)
      EXPECT_NEAR(even.at(row, col) + odd.at(row, col), white.at(row, col),
                  3e-4F * white.at(row, col));
}

// The profile of one pixel under stripes of every shift, against the pixel's response to each
// projector column integrated over the plane on a fine grid.
TEST_F(FlatPhantom, StripeHarmonicsAreThoseOfTheIntegralOverThePlane) {
  constexpr int kPeriod = 40, kWidth = 8;
  const std::array<std::array<int, 2>, 3> pixels = {{{18, 24}, {18, 25}, {19, 25}}};  // R, G, B
  std::vector<Image<float>> shots;
  shots.reserve(kPeriod);
  for (int shift = 0; shift < kPeriod; ++shift)
    shots.push_back(under(estimation::Stripes{estimation::Axis::kColumn, kPeriod, kWidth, shift}));
  for (const auto& [row, col] : pixels) {
    const auto band = static_cast<std::size_t>(estimation::band_at(plane_->rig.camera, row, col));
    const Vec3 at = plane_->point_at(row, col);
    std::vector<double> by_column(1024, 0.0);
    // Thin across the stripes, so that each strip falls to one or two columns by its overlap.
    constexpr double kAcross = 0.02, kAlong = 0.1, kReach = 25;
    for (double x = -kReach + kAcross / 2; x < kReach; x += kAcross)
      for (double y = -kReach + kAlong / 2; y < kReach; y += kAlong) {
        const Vec3 from = at + Vec3(x, y, 0);
        const double flux = kernel(x * x + y * y, kSigmaA[band], kSigmaS[band]) *
                            plane_->gain(from) * kAcross * kAlong;
        const double begin = plane_->projector_col(from - Vec3(kAcross / 2, 0, 0)) + 0.5;
        const double end = plane_->projector_col(from + Vec3(kAcross / 2, 0, 0)) + 0.5;
        const double edge = std::floor(end);
        const double before = begin < edge ? (edge - begin) / (end - begin) : 0;
        by_column[static_cast<std::size_t>(edge) - 1] += flux * before;
        by_column[static_cast<std::size_t>(edge)] += flux * (1 - before);
      }
    for (int n = 0; n <= 8; ++n) {
      std::complex<double> found = 0, expected = 0;
      for (int shift = 0; shift < kPeriod; ++shift) {
        const std::complex<double> wave =
            std::polar(1.0, 2 * std::numbers::pi * n * shift / kPeriod) / 8.0;
        found += wave * plane_->factor(shots[static_cast<std::size_t>(shift)], row, col);
        for (int c = 0; c < 1024; ++c)
          if (((c - shift) % kPeriod + kPeriod) % kPeriod < kWidth)
            expected += wave * by_column[static_cast<std::size_t>(c)];
      }
      if (n == 5) continue;  // a stripe of a fifth of the period has no fifth harmonic
      EXPECT_NEAR(std::abs(found - expected), 0, 0.004 * std::abs(expected) + 1e-4 * total(band))
          << "band " << band << " harmonic " << n << ": " << found << " for " << expected;
    }
  }
}

TEST_F(FlatPhantom, GeneralPicturesAddUpToSeparableOnes) {
  const TestRig& rig = plane_->rig;
  const estimation::Stripes stripes{estimation::Axis::kColumn, 40, 8, 11};
  Picture upper = make_picture(rig, stripes), lower = upper;
  for (int row = 0; row < rig.projector.height_px; ++row)
    for (int col = 0; col < rig.projector.width_px; ++col)
      (row < 400 ? lower : upper).brightness.at(row, col) = 0;
  const Image<float> a = world_->linear_image(upper), b = world_->linear_image(lower);
  const Image<float> both = under(stripes);
  float largest = 0;
  for (const float v : both.samples()) largest = std::max(largest, v);
  for (int row = 0; row < rig.camera.height_px; ++row)
    for (int col = 0; col < rig.camera.width_px; ++col)
      EXPECT_NEAR(a.at(row, col) + b.at(row, col), both.at(row, col), 1e-3F * largest);
}

TEST_F(FlatPhantom, TheSyncSquareLightsWhatItHits) {
  const TestRig& rig = plane_->rig;
  Picture square = make_picture(rig, estimation::Black{});
  Picture striped = make_picture(rig, estimation::Stripes{estimation::Axis::kRow, 40, 8, 3});
  const Image<float> without = world_->linear_image(striped);
  for (int row = 500; row < 600; ++row)
    for (int col = 700; col < 800; ++col) {
      square.brightness.at(row, col) = 255;
      striped.brightness.at(row, col) = 255;
    }
  EXPECT_EQ(split_picture(striped.brightness.view()).kind, SplitPicture::Kind::kRows);
  const Image<float> alone = world_->linear_image(square);
  const Image<float> with = world_->linear_image(striped);
  float largest = 0;
  for (std::size_t i = 0; i < with.samples().size(); ++i) {
    largest = std::max(largest, alone.samples()[i]);
    EXPECT_GE(with.samples()[i], without.samples()[i] - 1e-4F);
    EXPECT_LE(with.samples()[i], without.samples()[i] + alone.samples()[i] + 1e-4F);
  }
  EXPECT_GT(largest, 0.03F);
}

TEST(SplitPicture, KnowsTheKindsOfPictures) {
  const auto kind_of = [](const estimation::PatternKind& kind) {
    return split_picture(std::as_const(*std::make_unique<Image<unsigned char>>(
                                           estimation::render_pattern(kind, 60, 80)))
                             .view())
        .kind;
  };
  using estimation::Axis;
  EXPECT_EQ(kind_of(estimation::Stripes{Axis::kColumn, 40, 8, 1}), SplitPicture::Kind::kColumns);
  EXPECT_EQ(kind_of(estimation::GrayCode{Axis::kRow, 3, false}), SplitPicture::Kind::kRows);
  EXPECT_NE(kind_of(estimation::White{}), SplitPicture::Kind::kGeneral);
  Image<unsigned char> checks(60, 80);
  for (int row = 0; row < 60; ++row)
    for (int col = 0; col < 80; ++col)
      checks.at(row, col) = (row / 10 + col / 10) % 2 == 0 ? 255 : 0;
  EXPECT_EQ(split_picture(checks.view()).kind, SplitPicture::Kind::kGeneral);
}

// The tilted phantom: incidence of 44 degrees. Everything that the plane test checks, with tilt.
TEST(TiltedPhantom, FullyLitPlaneReflectsEquation5TimesTheCosine) {
  const TestRig rig = make_test_rig(49, 36, 1);
  SceneOptions options;
  options.name = "tilted_phantom";
  options.has_indirect = false;
  const auto world = make_world(rig, options);
  const Image<float> white = world->linear_image(make_picture(rig, estimation::White{}));
  const Vec3 normal(0.5, 0, -std::sqrt(0.75));  // turned 30 degrees about the vertical
  const Vec3 lamp =
      -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
  const auto& K = rig.calibration.camera.K;
  for (const auto& [row, col] : {std::array{18, 24}, std::array{18, 25}, std::array{19, 25}}) {
    const auto band = static_cast<std::size_t>(estimation::band_at(rig.camera, row, col));
    const Vec3 ray((col - K(0, 2)) / K(0, 0), (row - K(1, 2)) / K(1, 1), 1);
    const Vec3 point = ray * (Vec3(0, 0, 1000).dot(normal) / ray.dot(normal));
    const Vec3 to_lamp = lamp - point;
    const double d = cv::norm(to_lamp), d0 = *rig.calibration.irradiance->reference_distance_mm;
    const double gain = to_lamp.dot(normal) / d * (d0 / d) * (d0 / d);
    const double r = static_cast<double>(white.at(row, col)) /
                     rig.calibration.irradiance->signal_per_us[band] / gain;
    EXPECT_NEAR(r, total(band), 2e-3 * total(band)) << "band " << band;
  }
}

}  // namespace
}  // namespace hw_sim
