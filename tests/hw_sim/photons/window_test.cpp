// The volume under a face: its grids, and the photons of a few camera pixels.
#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <array>
#include <cmath>
#include <numbers>

#include "hw_sim/photons/pixel_response.h"
#include "tests/hw_sim/world/test_rig.h"

namespace hw_sim {
namespace {

using estimation::Vec3;

Box box_around(const Vec3& middle, double half_mm) {
  return {middle - Vec3::all(half_mm), middle + Vec3::all(half_mm)};
}

TEST(ShapeGrid, IsCloseToItsShape) {
  const auto ball = make_sphere({0, 0, 0}, 4);
  const ShapeGrid grid(*ball, box_around({0, 0, -4}, 2), 0.25);
  PhotonRandom random(1);
  for (int i = 0; i < 2000; ++i) {
    // On its grid and, one in four, beyond it.
    const double reach_mm = i % 4 == 0 ? 4.0 : 2.0;
    const auto offset = [&] { return reach_mm * (2 * random.uniform() - 1); };
    const Vec3 point = Vec3(offset(), offset(), offset() - 4);
    if (cv::norm(point) < 0.5) continue;
    // Linear interpolation is off by at most (cell)^2 / 8 times the curvatures' sum.
    EXPECT_NEAR(grid.distance_mm(point), ball->distance_mm(point),
                0.25 * 0.25 / 8 * 2 / (cv::norm(point) - 0.25) + 1e-5);
    EXPECT_LT(cv::norm(grid.normal(point) - point / cv::norm(point)), 0.004);
    EXPECT_NEAR(cv::norm(grid.on_surface(point)), 4, 0.006);
  }
}

// Flights near the surface are looked at less often the deeper a photon is: a shape must not claim
// to be deeper than twice what it is.
TEST(ShapeGrid, NoFaceClaimsTwiceItsDepth) {
  for (const char* name : {"face_female", "face_male"}) {
    const auto scene = make_scene(name);
    ASSERT_TRUE(scene);
    const Shape& shape = *scene->shape;
    PhotonRandom random(2);
    int inside_count = 0;
    double steepest = 0;
    while (inside_count < 20000) {
      const Vec3 point(140 * random.uniform() - 70, 190 * random.uniform() - 95,
                       950 + 80 * random.uniform());
      const double here = shape.distance_mm(point);
      if (here > 0 || here < -12) continue;
      ++inside_count;
      const auto way = deflected({0, 0, 1}, 2 * random.uniform() - 1, random);
      constexpr double kStepMm = 0.2;
      const double there = shape.distance_mm(point + kStepMm * Vec3(way[0], way[1], way[2]));
      steepest = std::max(steepest, std::abs(there - here) / kStepMm);
    }
    EXPECT_LT(steepest, 2) << name;
  }
}

// A lip's edge in miniature: a camera of few pixels, all bands.
class LipWindow : public testing::Test {
 protected:
  LipWindow()
      : rig_(make_test_rig(588, 432, 1)),
        scene_(*make_scene("face_female")),
        surface_(std::move(scene_.shape)),
        lamp_(rig_.calibration.projector, rig_.calibration.projector_from_camera,
              rig_.calibration.projector_from_camera_mm) {
    rig_.camera.width_px = 4;
    rig_.camera.height_px = 2;
    rig_.camera.roi_x_px = 304;
    rig_.camera.roi_y_px = 356;
    const Pinhole eye(rig_.calibration.camera, estimation::Mat3::eye(), {0, 0, 0});
    seen_ = find_seen_points(rig_.camera, eye, lamp_, 768, 1024, surface_, *scene_.skin, 0);
  }

  std::vector<ColumnResponse> trace(const PhotonOptions& options, int threads) const {
    std::vector<ColumnResponse> responses;
    tbb::task_arena(threads).execute([&] {
      const ShapeGrid grid(surface_.shape(), box_around(seen_.points[0].point_mm, 4), 0.25);
      const auto matter = SkinMatter::bands_of(*scene_.skin, grid);
      responses = trace_window(seen_, surface_, grid, {&matter[0], &matter[1], &matter[2]},
                               {lamp_, 768, 1024, 1030.97}, options, {});
    });
    return responses;
  }

  TestRig rig_;
  Scene scene_;
  Surface surface_;
  Pinhole lamp_;
  SeenPoints seen_;
};

TEST_F(LipWindow, SameSeedSameNumbersForAnyNumberOfThreads) {
  ASSERT_EQ(seen_.samples.size(), 8U);
  const auto one = trace({.paths_per_sample = 64, .seed = 4}, 1);
  const auto three = trace({.paths_per_sample = 64, .seed = 4}, 3);
  const auto other = trace({.paths_per_sample = 64, .seed = 5}, 3);
  for (std::size_t i = 0; i < one.size(); ++i) {
    ASSERT_GT(one[i].end(), one[i].begin());
    bool is_other = false;
    for (int column = 0; column < 1024; ++column) {
      EXPECT_EQ(one[i].at(column), three[i].at(column));
      is_other |= one[i].at(column) != other[i].at(column);
    }
    EXPECT_TRUE(is_other);
  }
}

TEST_F(LipWindow, SeesItsSkinAroundItsOwnColumn) {
  const auto responses = trace({.paths_per_sample = 512}, 2);
  const std::vector<double> white(1024, 1.0);
  for (std::size_t i = 0; i < responses.size(); ++i) {
    const SeenPoint& point = seen_.points[static_cast<std::size_t>(seen_.owners[i])];
    const double column_px = lamp_.project(point.point_mm).col_px;
    double middle_px = 0;
    for (int column = responses[i].begin(); column < responses[i].end(); ++column)
      middle_px += column * responses[i].at(column);
    const Estimate all = responses[i].lit_by(white);
    // The paper's lips and skin reflect a tenth to a half; light comes from within millimetres.
    EXPECT_GT(all.value, 0.05);
    EXPECT_LT(all.value, 0.6);
    EXPECT_NEAR(middle_px / all.value, column_px, 6);
    EXPECT_GT(all.standard_error, 0.01 * all.value);
    EXPECT_LT(all.standard_error, 0.2 * all.value);
  }
}

// In a room as bright in all directions, a point shines with what its paths let out again: light
// collected on its way in, through lips and nostrils as they curve, is light that gets out.
TEST(Photons, WhatComesInThroughACurvedSurfaceIsWhatGetsOut) {
  const TestRig rig = make_test_rig(588, 432, 1);
  auto scene = make_scene("face_female");
  ASSERT_TRUE(scene);
  const Surface surface(std::move(scene->shape));
  const Pinhole eye(rig.calibration.camera, estimation::Mat3::eye(), {0, 0, 0});
  constexpr std::array<std::array<int, 2>, 3> kPixels = {{{352, 305}, {360, 305}, {303, 284}}};
  for (const auto& [row, col] : kPixels) {
    const auto hit = surface.first_hit(eye.ray(col, row));
    ASSERT_TRUE(hit);
    const ShapeGrid grid(surface.shape(), box_around(hit->point_mm, 6), 0.25);
    const auto matter = SkinMatter::bands_of(*scene->skin, grid);
    const auto start = seen_path(grid, hit->point_mm, -hit->point_mm / cv::norm(hit->point_mm));
    ASSERT_TRUE(start);
    std::vector<double> differences;
    double all_out = 0;
    std::vector<Deposit> deposits;
    constexpr int kBatches = 16, kPaths = 1200;
    for (std::uint64_t batch = 0; batch < kBatches; ++batch) {
      PhotonRandom random(51 + batch);
      double in = 0, out = 0;
      for (int path = 0; path < kPaths; ++path) {
        const auto from = deflected({0, 0, 1}, 2 * random.uniform() - 1, random);
        constexpr double kFarMm = 1e6;
        const Lamp lamp{hit->point_mm + kFarMm * Vec3(from[0], from[1], from[2]), kFarMm * kFarMm};
        deposits.clear();
        const PathEnd end = AdjointWalk(grid, matter[1], lamp).trace(*start, random, deposits);
        out += end.weight * kSkinIndex * kSkinIndex / std::numbers::pi;
        for (const Deposit& deposit : deposits) in += 4 * deposit.weight;
      }
      differences.push_back((in - out) / kPaths);
      all_out += out / kPaths / kBatches;
    }
    const Estimate difference = estimate_of(differences);
    EXPECT_GT(all_out, 0.1);
    EXPECT_LT(difference.standard_error, 0.03 * all_out);
    EXPECT_NEAR(difference.value, 0, 3.5 * difference.standard_error) << "of " << all_out;
  }
}

// A ball's light that leaves is gone: bounces change nothing. What is gathered over batches is
// what each batch gathered.
TEST(Photons, AConvexBodyHasNoIndirectLight) {
  const TestRig rig = make_test_rig(21, 16, 1);
  auto scene = make_scene("sphere");
  ASSERT_TRUE(scene);
  const Surface surface(std::move(scene->shape));
  const Pinhole eye(rig.calibration.camera, estimation::Mat3::eye(), {0, 0, 0});
  const Pinhole lamp(rig.calibration.projector, rig.calibration.projector_from_camera,
                     rig.calibration.projector_from_camera_mm);
  SeenPoints seen = find_seen_points(rig.camera, eye, lamp, 768, 1024, surface, *scene->skin, 0);
  seen.samples.erase(seen.samples.begin(), seen.samples.end() - 6);
  seen.owners.erase(seen.owners.begin(), seen.owners.end() - 6);
  seen.bands.erase(seen.bands.begin(), seen.bands.end() - 6);
  const Vec3 first = seen.points[static_cast<std::size_t>(seen.owners[0])].point_mm;
  const ShapeGrid grid(surface.shape(), box_around(first, 4), 0.5);
  const auto matter = SkinMatter::bands_of(*scene->skin, grid);
  const auto trace = [&](bool has_indirect) {
    return trace_window(seen, surface, grid, {&matter[0], &matter[1], &matter[2]},
                        {lamp, 768, 1024, 1030.97},
                        {.paths_per_sample = 64, .has_indirect = has_indirect}, {});
  };
  const auto direct = trace(false), with_bounces = trace(true);
  std::vector<double> white(1024, 1.0);
  for (std::size_t i = 0; i < direct.size(); ++i) {
    EXPECT_EQ(direct[i].lit_by(white).value, with_bounces[i].lit_by(white).value);
    double sum = 0;
    for (int column = direct[i].begin(); column < direct[i].end(); ++column)
      sum += direct[i].at(column);
    EXPECT_NEAR(sum, direct[i].lit_by(white).value, 1e-6);
  }
}

}  // namespace
}  // namespace hw_sim
