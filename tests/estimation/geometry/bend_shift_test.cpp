// Stripes on a ball whose light spreads, summed in space over the ball itself.
#include "estimation/geometry/bend_shift.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/parallel_for.h>

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "tests/estimation/geometry/synthetic_rig.h"

namespace estimation {
namespace {

using testing::SyntheticRig;

const Vec3 kBallMm{0, 0, 1000};
constexpr double kBallRadiusMm = 35;
constexpr int kPeriodPx = 40, kWidthPx = 8;

SyntheticRig rig_before_ball() {
  SyntheticRig rig = testing::make_rig(600, 400, false);
  rig.camera.roi_x_px = 262;
  rig.camera.roi_y_px = 168;
  rig.camera.width_px = 76;
  rig.camera.height_px = 64;
  return rig;
}

struct Lit {
  double column_px = 0, flux = 0;
};

class Ball {
 public:
  explicit Ball(const SyntheticRig& rig) : rig_(rig) {
    centre_mm_ =
        -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
  }

  Vec3 point(int row, int col) const {
    const Mat3& K = rig_.calibration.camera.K;
    const Vec3 way((col + rig_.camera.roi_x_px - K(0, 2)) / K(0, 0),
                   (row + rig_.camera.roi_y_px - K(1, 2)) / K(1, 1), 1);
    return way * *testing::sphere(kBallMm, kBallRadiusMm).depth_mm(way);
  }

  Lit lit(const Vec3& point_mm) const {
    const Vec3 p = rig_.calibration.projector_from_camera * point_mm +
                   rig_.calibration.projector_from_camera_mm;
    const Mat3& K = rig_.calibration.projector.K;
    const Vec3 to_lamp = centre_mm_ - point_mm;
    const double distance = cv::norm(to_lamp);
    const double cosine = (point_mm - kBallMm).dot(to_lamp) / (kBallRadiusMm * distance);
    return {K(0, 0) * p[0] / p[2] + K(0, 2), std::max(cosine, 0.0) / (distance * distance)};
  }

  // What a pixel gets from each tenth of a column of the period, its light spread as
  // exp(-r / spread_mm).
  static constexpr int kBins = 10 * kPeriodPx;
  std::array<double, kBins> profile(const Vec3& at_mm, double spread_mm) const {
    std::array<double, kBins> bins{};
    const auto add = [&](const Vec3& point_mm, double weight) {
      const Lit light = lit(point_mm);
      const double turns = (light.column_px + 0.5) / kPeriodPx;
      const double place = (turns - std::floor(turns)) * kBins;
      bins[std::min(static_cast<std::size_t>(place), bins.size() - 1)] += weight * light.flux;
    };
    if (spread_mm == 0) {
      add(at_mm, 1);
      return bins;
    }
    const Vec3 normal = (at_mm - kBallMm) / kBallRadiusMm;
    const Vec3 any = std::abs(normal[0]) < 0.9 ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 x = normal.cross(any) / cv::norm(normal.cross(any)), y = normal.cross(x);
    constexpr int kRings = 60, kSectors = 48;
    const double step_mm = 9 * spread_mm / kRings;
    for (int ring = 0; ring < kRings; ++ring) {
      const double r_mm = (ring + 0.5) * step_mm, angle = r_mm / kBallRadiusMm;
      const double area = kBallRadiusMm * std::sin(angle) * step_mm;
      for (int sector = 0; sector < kSectors; ++sector) {
        const double around = 2 * std::numbers::pi * (sector + 0.5) / kSectors;
        const Vec3 way = std::cos(around) * x + std::sin(around) * y;
        add(kBallMm + kBallRadiusMm * (std::cos(angle) * normal + std::sin(angle) * way),
            area * std::exp(-r_mm / spread_mm));
      }
    }
    return bins;
  }

 private:
  const SyntheticRig& rig_;
  Vec3 centre_mm_;
};

struct Sweep {
  std::vector<PatternKind> kinds;
  std::vector<Image<float>> frames;
  Correspondence found;  // the first harmonic's phase, in the right period
  Image<double> truth_px;

  std::vector<PatternSignal> signals() const {
    std::vector<PatternSignal> signals;
    for (std::size_t i = 0; i < kinds.size(); ++i) signals.push_back({&kinds[i], frames[i].view()});
    return signals;
  }
};

Sweep sweep_of(const SyntheticRig& rig, double spread_mm) {
  const int height = rig.camera.height_px, width = rig.camera.width_px;
  Sweep sweep;
  for (int shift_px = 0; shift_px < kPeriodPx; ++shift_px)
    sweep.kinds.push_back(Stripes{Axis::kColumn, kPeriodPx, kWidthPx, shift_px});
  sweep.frames.assign(kPeriodPx, Image<float>(height, width));
  sweep.found.validity = Image<std::uint32_t>(height, width);
  sweep.found.column_px = Image<float>(height, width);
  sweep.found.column_sd_px = Image<float>(height, width, 1, 0.01F);
  sweep.truth_px = Image<double>(height, width);
  const Ball ball(rig);
  tbb::parallel_for(0, height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      const Vec3 point_mm = ball.point(row, col);
      const auto bins = ball.profile(point_mm, spread_mm);
      double cosine = 0, sine = 0;
      for (int shift_px = 0; shift_px < kPeriodPx; ++shift_px) {
        double sum = 0;
        for (int i = 0; i < 10 * kWidthPx; ++i)
          sum += bins[static_cast<std::size_t>((10 * shift_px + i) % Ball::kBins)];
        sweep.frames[static_cast<std::size_t>(shift_px)].at(row, col) = static_cast<float>(sum);
        const double angle = 2 * std::numbers::pi * (shift_px + (kWidthPx - 1) / 2.0) / kPeriodPx;
        cosine += sum * std::cos(angle);
        sine += sum * std::sin(angle);
      }
      const double phase_px = std::atan2(sine, cosine) * kPeriodPx / (2 * std::numbers::pi);
      const double truth_px = ball.lit(point_mm).column_px;
      sweep.truth_px.at(row, col) = truth_px;
      sweep.found.column_px.at(row, col) =
          static_cast<float>(truth_px + std::remainder(phase_px - truth_px, double{kPeriodPx}));
    }
  });
  return sweep;
}

struct Errors {
  double rms_px = 0, pull_rms = 0, position_rms_mm = 0, position_pull_rms = 0;
};

// More than six pixels from the picture's border.
Errors errors_of(const SyntheticRig& rig, const Sweep& sweep, const Correspondence& found,
                 const Surface& surface) {
  constexpr int kBorder = 6;
  const Ball ball(rig);
  double squares = 0, pulls = 0, positions = 0, position_pulls = 0;
  int count = 0;
  for (int row = kBorder; row < rig.camera.height_px - kBorder; ++row)
    for (int col = kBorder; col < rig.camera.width_px - kBorder; ++col) {
      const double error_px = double{found.column_px.at(row, col)} - sweep.truth_px.at(row, col);
      const Vec3 off_mm = Vec3(double{surface.position_mm[0].at(row, col)},
                               double{surface.position_mm[1].at(row, col)},
                               double{surface.position_mm[2].at(row, col)}) -
                          ball.point(row, col);
      squares += error_px * error_px;
      pulls += std::pow(error_px / double{found.column_sd_px.at(row, col)}, 2);
      positions += off_mm.dot(off_mm);
      position_pulls +=
          off_mm.dot(off_mm) / std::pow(double{surface.position_sd_mm.at(row, col)}, 2);
      ++count;
    }
  return {std::sqrt(squares / count), std::sqrt(pulls / count), std::sqrt(positions / count),
          std::sqrt(position_pulls / count)};
}

TEST(BendShift, OfAScatteringBallIsTakenOff) {
  const SyntheticRig rig = rig_before_ball();
  const Sweep sweep = sweep_of(rig, 1.2);
  Correspondence found = sweep.found;
  const Surface bent = reconstruct_surface(rig.calibration, rig.camera, rig.projector, found, {});
  const Errors before = errors_of(rig, sweep, found, bent);
  const Surface surface = reconstruct_bent_surface(sweep.signals(), rig.calibration, rig.camera,
                                                   rig.projector, {}, {}, found);
  const Errors after = errors_of(rig, sweep, found, surface);
  EXPECT_GT(before.rms_px, 0.08);
  EXPECT_LT(after.rms_px, before.rms_px / 4);
  EXPECT_LT(after.position_rms_mm, before.position_rms_mm / 4);
  EXPECT_LT(after.pull_rms, 1.2);
  EXPECT_GT(before.position_pull_rms, 10);
  EXPECT_LT(after.position_pull_rms, 1.2);
}

TEST(BendShift, LightThatStaysWhereItFallsIsLeftAlone) {
  const SyntheticRig rig = rig_before_ball();
  const Sweep sweep = sweep_of(rig, 0);
  Correspondence found = sweep.found;
  reconstruct_bent_surface(sweep.signals(), rig.calibration, rig.camera, rig.projector, {}, {},
                           found);
  for (std::size_t i = 0; i < found.column_px.samples().size(); ++i)
    ASSERT_EQ(found.column_px.samples()[i], sweep.found.column_px.samples()[i]);
}

TEST(BendShift, WithoutASweepThereIsNothingToTellItFrom) {
  const SyntheticRig rig = rig_before_ball();
  const Sweep sweep = sweep_of(rig, 1.2);
  Correspondence found = sweep.found;
  std::vector<PatternSignal> signals = sweep.signals();
  signals.resize(4);
  reconstruct_bent_surface(signals, rig.calibration, rig.camera, rig.projector, {}, {}, found);
  for (std::size_t i = 0; i < found.column_px.samples().size(); ++i)
    ASSERT_EQ(found.column_px.samples()[i], sweep.found.column_px.samples()[i]);
}

}  // namespace
}  // namespace estimation
