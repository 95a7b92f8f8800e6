// The room and the subject: what of them the frames show, and what the truth says of it.
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <sstream>
#include <string>

#include "estimation/session/maps.h"
#include "tests/hw_sim/world/phantom_shots.h"
#include "tests/temporary_folder.h"

namespace hw_sim {
namespace {

using estimation::Axis;
using estimation::Black;
using estimation::Image;
using estimation::Stripes;
using estimation::Vec3;
using estimation::White;

struct PoseLine {
  std::uint64_t trigger = 0;
  double start_s = 0, exposure_s = 0, open_eyes_frac = 0;
  Vec3 displacement_mm;
};

std::vector<PoseLine> poses_of(const HeadWorld& world) {
  const test_support::TemporaryFolder folder;
  EXPECT_TRUE(world.write_truth(folder.path()));
  std::ifstream file(folder.path() / "poses.csv");
  std::string line;
  std::getline(file, line);
  std::vector<PoseLine> poses;
  while (std::getline(file, line)) {
    std::ranges::replace(line, ',', ' ');
    std::istringstream fields(line);
    PoseLine pose;
    fields >> pose.trigger >> pose.start_s >> pose.exposure_s >> pose.displacement_mm[0] >>
        pose.displacement_mm[1] >> pose.displacement_mm[2] >> pose.open_eyes_frac;
    pose.start_s *= 1e-9;
    pose.exposure_s *= 1e-6;
    poses.push_back(pose);
  }
  return poses;
}

TEST(SubjectEffects, BreathingAndDriftMoveTheStripesAndTheTruthSaysBy) {
  SceneOptions scene = quick_scene("flat_phantom");
  scene.effects.drift_mm_per_s = {0, 0, 4};
  scene.effects.breathing_mm = {0, 0, 3};
  scene.effects.breathing_hz = 1.3;
  const TestRig rig = quiet_rig();
  const auto world = make_world(rig, scene);
  const auto still = make_world(rig, quick_scene("flat_phantom"));
  const Stripes stripes{Axis::kColumn, 40, 8, 3};
  constexpr int kCol = 15;  // beside a stripe: its light comes and goes
  const std::vector<estimation::PatternKind> again(8, stripes);
  const auto shots = RigShots(rig, *world).take(again, {microseconds(50000)});
  const auto resting = RigShots(rig, *still).take({stripes}, {microseconds(50000)});
  const auto poses = poses_of(*world);
  ASSERT_EQ(poses.size(), shots.size());
  double furthest = 0, largest_change = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    EXPECT_EQ(poses[i].trigger, shots[i].trigger_number);
    const double elapsed_s = poses[i].start_s - poses[0].start_s + poses[i].exposure_s / 2;
    const double z_mm = 4 * elapsed_s + 3 * std::sin(2 * std::numbers::pi * 1.3 * elapsed_s);
    EXPECT_NEAR(poses[i].displacement_mm[2], z_mm, 1e-4);
    furthest = std::max(furthest, std::abs(z_mm));
    // A phantom farther away by as much is lit like a still one under stripes displaced by what
    // triangulation says.
    const auto column_at = [&](double mm) {
      const auto& c = rig.calibration;
      const Vec3 point(mm * (kCol - c.camera.K(0, 2)) / c.camera.K(0, 0),
                       mm * (18 - c.camera.K(1, 2)) / c.camera.K(1, 1), mm);
      const Vec3 local = c.projector_from_camera * point + c.projector_from_camera_mm;
      return c.projector.K(0, 0) * local[0] / local[2];
    };
    const double moved_px = column_at(1000 + z_mm) - column_at(1000);
    const int whole = static_cast<int>(std::floor(moved_px));
    const auto displaced = [&](int by) {
      return 50000 *
             static_cast<double>(still
                                     ->linear_image(make_picture(
                                         rig, Stripes{Axis::kColumn, 40, 8, 3 - by}, 50 + i))
                                     .at(18, kCol));
    };
    const double part = moved_px - whole;
    const double expected = (1 - part) * displaced(whole) + part * displaced(whole + 1);
    EXPECT_NEAR(shots[i].at(18, kCol) - kBlackDn, expected, 0.01 * expected + 3) << i;
    largest_change =
        std::max(largest_change, std::abs(shots[i].at(18, kCol) - resting[0].at(18, kCol)));
  }
  EXPECT_GT(furthest, 2);
  EXPECT_GT(largest_change, 100);
}

TEST(SubjectEffects, ABlinkChangesTheEyesAndNothingElse) {
  TestRig rig = make_test_rig(98, 72, 4);
  remove_noise(rig);
  SceneOptions scene = quick_scene("face_female");
  scene.effects.blink_start_s = 0.1;
  scene.effects.blink_s = 0.15;
  const auto world = make_world(rig, scene);
  const auto shots =
      RigShots(rig, *world)
          .take(std::vector<estimation::PatternKind>(8, White{}), {microseconds(10000)});
  const auto poses = poses_of(*world);
  ASSERT_EQ(poses.size(), shots.size());
  int open = 0;
  for (std::size_t i = 0; i < shots.size(); ++i) {
    int changed = 0;
    for (int row = 0; row < 72; ++row)
      for (int col = 6; col < 98; ++col) {
        if (shots[i].at(row, col) == shots[0].at(row, col)) continue;
        ++changed;
        const double x_mm = (col - 48.5) / 313.3 * 1010, y_mm = (row - 35.5) / 313.3 * 1010;
        EXPECT_NEAR(std::abs(x_mm), 30.5, 14) << row << " " << col;
        EXPECT_NEAR(y_mm, 7, 8) << row << " " << col;
      }
    EXPECT_EQ(changed > 0, poses[i].open_eyes_frac > 0) << i;
    open += changed > 4 ? 1 : 0;
  }
  EXPECT_GT(open, 0);
  EXPECT_LT(open, 7);
}

TEST(RoomEffects, LightThatMissesTheSubjectMeetsTheWall) {
  Effects effects;
  effects.backdrop_reflectance_frac = 0.5;
  effects.backdrop_mm = 1300;
  const TestRig rig = quiet_rig();
  const auto dark = phantom_shots({}, {White{}, Stripes{Axis::kRow, 96, 48, 0}});
  const auto lit = phantom_shots(effects, {White{}, Stripes{Axis::kRow, 96, 48, 0}});
  const auto& c = rig.calibration;
  const Vec3 lamp = -(c.projector_from_camera.t() * c.projector_from_camera_mm);
  int wall = 0, shadow = 0;
  for (int row = 0; row < 36; ++row)
    for (int col = 6; col < 49; ++col) {
      if (dark[0].at(row, col) > 70) {  // the phantom: no more light than before
        EXPECT_EQ(lit[0].at(row, col), dark[0].at(row, col));
        continue;
      }
      const Vec3 at(1300 * (col - c.camera.K(0, 2)) / c.camera.K(0, 0),
                    1300 * (row - c.camera.K(1, 2)) / c.camera.K(1, 1), 1300);
      const Vec3 local = c.projector_from_camera * at + c.projector_from_camera_mm;
      const double u = c.projector.K(0, 0) * local[0] / local[2] + c.projector.K(0, 2);
      const double v = c.projector.K(1, 1) * local[1] / local[2] + c.projector.K(1, 2);
      if (u < 0 || v < 0 || u > rig.projector.width_px - 9 || v > rig.projector.height_px - 9)
        continue;
      const double signal = lit[0].at(row, col) - kBlackDn;
      if (signal < 1) {
        ++shadow;  // of the phantom
        continue;
      }
      const double d = cv::norm(lamp - at), d0 = *c.irradiance->reference_distance_mm;
      const auto band = static_cast<std::size_t>(estimation::band_at(rig.camera, row, col));
      EXPECT_NEAR(
          signal,
          10000 * c.irradiance->signal_per_us[band] * 0.5 * (at[2] - lamp[2]) / d * d0 * d0 / d / d,
          1)
          << row << " " << col;
      ++wall;
      const int stripe_row = static_cast<int>(std::lround(v)) % 96;
      if (stripe_row > 2 && stripe_row < 45) {
        EXPECT_NEAR(lit[1].at(row, col), lit[0].at(row, col), 2);
      } else if (stripe_row > 51 && stripe_row < 93) {
        EXPECT_EQ(lit[1].at(row, col), kBlackDn);
      }
    }
  EXPECT_GT(wall, 50);
  EXPECT_GT(shadow, 10);
}

TEST(RoomEffects, TheWallSendsLightBackToTheSubjectsSides) {
  TestRig rig = make_test_rig(49, 36, 4);
  const Picture white = make_picture(rig, White{});
  SceneOptions scene = quick_scene("sphere");
  scene.has_indirect = true;
  const Image<float> dark = make_world(rig, scene)->linear_image(white);
  scene.effects.backdrop_reflectance_frac = 0.8;
  scene.effects.backdrop_mm = 1200;
  const Image<float> lit = make_world(rig, scene)->linear_image(white);
  // The sphere's outline looks half at the wall, its middle not at all.
  float middle = 0, rim = 0;
  for (int col = 0; col < 49; ++col) {
    if (!(dark.at(18, col) > 0)) continue;
    const float added = lit.at(18, col) - dark.at(18, col);
    EXPECT_GE(added, 0);
    if (col == 24) middle = added;
    rim = std::max(rim, added);
  }
  EXPECT_LT(middle, 1e-4F);
  EXPECT_GT(rim, 2e-4F);
}

// The wedge's two pages as rectangles that send light to and fro: irradiance by bounce, by plain
// quadrature. Places: (page -1 or 1, mm from the spine, mm down).
class TwoPages {
 public:
  explicit TwoPages(const TestRig& rig) : calibration_(rig.calibration) {
    for (const int page : {-1, 1})
      for (int i = 0; i < kAlong; ++i)
        for (int j = 0; j < kDown; ++j)
          elements_.push_back({page, (i + 0.5) * 110 / kAlong, (j + 0.5) * 170 / kDown - 85});
    for (const Place& each : elements_) direct_.push_back(gain(each));
  }
  struct Place {
    int page;
    double along_mm, down_mm;
  };
  // Of `light` on the elements, reflected with `reflectance`.
  double received(const Place& at, const std::vector<double>& light, double reflectance) const {
    constexpr double kArea_mm2 = 110.0 / kAlong * 170.0 / kDown;
    double sum = 0;
    for (std::size_t i = 0; i < elements_.size(); ++i) {
      if (elements_[i].page == at.page) continue;
      const Vec3 way = point(elements_[i]) - point(at);
      const double d2 = way.dot(way);
      sum += light[i] * way.dot(normal(at.page)) * -way.dot(normal(elements_[i].page)) / (d2 * d2);
    }
    return reflectance * sum * kArea_mm2 / std::numbers::pi;
  }
  std::vector<double> bounced(const std::vector<double>& light, double reflectance) const {
    std::vector<double> next;
    for (const Place& each : elements_) next.push_back(received(each, light, reflectance));
    return next;
  }
  const std::vector<double>& direct() const { return direct_; }
  double gain(const Place& at) const {
    const auto& c = calibration_;
    const Vec3 lamp = -(c.projector_from_camera.t() * c.projector_from_camera_mm);
    const Vec3 way = lamp - point(at);
    const double d = cv::norm(way), d0 = *c.irradiance->reference_distance_mm;
    return way.dot(normal(at.page)) / d * d0 * d0 / d / d;
  }
  static Vec3 normal(int page) { return {-page * 0.5, 0, -std::sqrt(0.75)}; }
  static Vec3 point(const Place& at) {
    return {at.page * std::sqrt(0.75) * at.along_mm, at.down_mm, 1027 - 0.5 * at.along_mm};
  }

 private:
  static constexpr int kAlong = 44, kDown = 34;
  const estimation::Calibration& calibration_;
  std::vector<Place> elements_;
  std::vector<double> direct_;
};

TEST(Interreflection, EachBounceInAWedgeIsThatOfTwoPages) {
  const TestRig rig = make_test_rig(98, 72, 4);
  SceneOptions scene = quick_scene("wedge");
  scene.has_indirect = true;
  std::vector<estimation::Maps> truths;
  for (const int bounces : {1, 2}) {
    scene.bounces = bounces;
    const test_support::TemporaryFolder folder;
    ASSERT_TRUE(make_world(rig, scene)->write_truth(folder.path()));
    truths.push_back(*estimation::read_maps(folder.path()));
  }
  const TwoPages pages(rig);
  const std::size_t red = 0;
  const auto reflectance = static_cast<double>(truths[0].diffuse_reflectance[red].at(36, 40));
  const std::vector<double> once = pages.bounced(pages.direct(), reflectance);
  for (const int col : {38, 44, 53, 60}) {
    const auto x_mm = static_cast<double>(truths[0].position_mm[0].at(36, col));
    const TwoPages::Place at{x_mm < 0 ? -1 : 1, std::abs(x_mm) / std::sqrt(0.75),
                             static_cast<double>(truths[0].position_mm[1].at(36, col))};
    const double first = pages.received(at, pages.direct(), reflectance);
    const double second = pages.received(at, once, reflectance);
    const double scale = reflectance / pages.gain(at);
    const auto found = static_cast<double>(truths[0].indirect[red].at(36, col));
    const auto found_both = static_cast<double>(truths[1].indirect[red].at(36, col));
    EXPECT_NEAR(found / (first * scale), 1, 0.04) << col;
    EXPECT_NEAR((found_both - found) / (second * scale), 1, 0.06) << col;
    EXPECT_GT(second, 0.03 * first);
  }
}

TEST(Effects, AllAtOnceTheSameSeedIsTheSameBytesForAnyNumberOfThreads) {
  const TestRig rig = make_test_rig(49, 36, 8);
  SceneOptions scene = quick_scene("face_female", every_effect());
  scene.has_indirect = true;
  const auto frames = [&](int threads, std::uint64_t seed) {
    scene.thread_count = threads;
    scene.seed = seed;
    const auto world = make_world(rig, scene);
    std::vector<std::uint16_t> bytes;
    for (const Shot& shot : RigShots(rig, *world)
                                .take({White{}, Stripes{Axis::kColumn, 40, 8, 0}, Black{}},
                                      {microseconds(4000), microseconds(16000)}))
      bytes.insert(bytes.end(), shot.dn.samples().begin(), shot.dn.samples().end());
    return bytes;
  };
  const auto once = frames(1, 1);
  EXPECT_EQ(once.size(), 6U * 49 * 36);
  EXPECT_EQ(once, frames(3, 1));
  EXPECT_NE(once, frames(1, 2));
}

}  // namespace
}  // namespace hw_sim
