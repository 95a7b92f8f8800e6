// The simulator's white Monte Carlo against conservation laws, an independent Monte Carlo code's
// figures, and itself: what is tabulated in space is what was walked.
#include "hw_sim/world/scatter_table.h"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <fstream>
#include <map>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "hw_sim/world/layer_doubling.h"
#include "hw_sim/world/white_walk.h"
#include "tests/hw_sim/world/kernel_spectrum.h"
#include "tests/hw_sim/world/test_rig.h"
#include "tests/temporary_folder.h"

namespace hw_sim {
namespace {

using estimation::Image;
using estimation::Vec3;

constexpr double kDegree = std::numbers::pi / 180;
constexpr Scattering kCheek[3] = {{0.0525, 1.2814}, {0.1653, 1.5}, {0.2216, 1.1248}};
constexpr int kPhotons = 150'000;

constexpr std::uint64_t kWorldsSeed = 20260;  // of hw_sim/world/head_light.cpp

const test_support::TemporaryFolder& cache() {
  static const test_support::TemporaryFolder folder;
  return folder;
}

// Also what a world with that many photons reads.
const ScatterTable& table() {
  static const ScatterTable made = ScatterTable::cached(cache().path(), kPhotons, kWorldsSeed, {});
  return made;
}

TEST(WhiteWalk, LosesNoEnergy) {
  PhotonRandom random(3);
  for (const double incidence_rad : {0.0, 60 * kDegree}) {
    constexpr int kCount = 60000;
    constexpr double kLongMm = 60;         // at a sigma_s' of 1/mm
    double out = 0, out2 = 0, within = 0;  // what left, and what is under way still
    for (int i = 0; i < kCount; ++i) {
      Walk walk;
      walk.u = std::sin(incidence_rad) / kSkinIndex;
      walk.w = std::sqrt(1 - walk.u * walk.u);
      double left = 0;
      bool is_alive = true;
      while (is_alive && walk.length < kLongMm) {
        is_alive = walk.fly(random, [&](const PhotonExit& exit) { left += exit.weight; });
        if (is_alive) walk.scatter(random);
      }
      if (is_alive) left += walk.weight;
      within += is_alive ? walk.weight : 0;
      out += left;
      out2 += left * left;
    }
    const double mean = out / kCount, se = std::sqrt((out2 / kCount - mean * mean) / kCount);
    EXPECT_LT(se, 0.002);
    EXPECT_NEAR(mean, 1, 4 * se);
    EXPECT_GT(within / kCount, 0.05);
    EXPECT_LT(within / kCount, 0.5);
  }
}

TEST(WhiteWalk, ThinningKeepsTheMeanWeight) {
  PhotonRandom random(4);
  constexpr int kCount = 200000;
  double kept = 0;
  for (int i = 0; i < kCount; ++i) {
    Walk walk;
    walk.length = 3 * Walk::kThinned;  // two octaves on
    if (walk.survives(random) && walk.survives(random)) kept += walk.weight;
  }
  EXPECT_NEAR(kept / kCount, 1, 4 * std::sqrt(1.0 / kCount));  // 2 with probability 1/2
}

TEST(WhiteWalk, BoundaryIsFresnels) {
  EXPECT_NEAR(fresnel_reflectance(1, 1, 1.4), 1.0 / 36, 1e-12);  // ((n-1)/(n+1))^2
  EXPECT_NEAR(1 - fresnel_reflectance(std::cos(45 * kDegree), 1, 1.4), 0.963, 5e-4);
  EXPECT_NEAR(1 - fresnel_reflectance(std::cos(60 * kDegree), 1, 1.4), 0.928, 5e-4);
  EXPECT_EQ(fresnel_reflectance(0.5, 1.4, 1), 1);  // beyond the critical angle
  const double into = std::sqrt(1 - std::pow(std::sin(0.6) / 1.4, 2));
  EXPECT_NEAR(fresnel_reflectance(std::cos(0.6), 1, 1.4), fresnel_reflectance(into, 1.4, 1), 1e-12);
}

// All exit directions together, normal incidence: tests/data/mc_truth_rf.csv, by another code.
TEST(ScatterTable, HarmonicsAreThoseOfAnotherMonteCarloCode) {
  std::ifstream file(SSRIG_TEST_DATA "/mc_truth_rf.csv");
  ASSERT_TRUE(file);
  std::string line;
  int compared = 0;
  double worst = 0;
  const double harmonics[] = {0, 0.08, 0.17, 0.25, 0.33, 0.5};  // 0, 1, 2, 3, 4, 6 over 12 mm
  std::map<std::string, Rings> by_medium;
  while (std::getline(file, line)) {
    if (line.empty() || line[0] == '#' || line.starts_with("name")) continue;
    for (char& c : line)
      if (c == ',') c = ' ';
    std::istringstream row(line);
    std::string name;
    Scattering medium;
    double photons = 0, freq_per_mm = 0, expected = 0;
    row >> name >> medium.sigma_a_per_mm >> medium.sigma_s_prime_per_mm >> photons >> freq_per_mm >>
        expected;
    bool is_wanted = false;
    for (const double harmonic : harmonics) is_wanted |= std::abs(freq_per_mm - harmonic) < 1e-6;
    if (!is_wanted) continue;
    Rings& rings = by_medium[name];
    if (rings.empty()) rings = over_all_exits(table().material(medium), 0, 60, 4);
    const double found = transform(rings, freq_per_mm).real();
    // A photon's weight is at most about 1: its variance at most R at these frequencies.
    const double own_se = std::sqrt(expected / kPhotons), file_se = std::sqrt(expected / photons);
    const double tolerance =
        (freq_per_mm == 0 ? 0.005 : 0.01) * expected + 3 * std::hypot(own_se, file_se);
    EXPECT_NEAR(found, expected, tolerance) << name << " at " << freq_per_mm << "/mm";
    worst = std::max(worst, std::abs(found / expected - 1));
    ++compared;
  }
  EXPECT_EQ(compared, 8 * 6);
  RecordProperty("worst_relative_error", std::to_string(worst));
}

// One direction of exit each, up to 60 degrees of incidence and 46 of exit:
// tests/data/mc_tilted.csv, by a third program. Nothing of harmonic 0 is left to the photons.
TEST(ScatterTable, TiltedPhantomsAreThoseOfAThirdProgram) {
  const auto phantoms = read_tilted(SSRIG_TEST_DATA "/mc_tilted.csv");
  ASSERT_EQ(phantoms.size(), 15U);
  double off2 = 0, noise2 = 0;
  for (const TiltedPhantom& phantom : phantoms) {
    const auto found = harmonics_of(table(), phantom);
    for (const std::size_t n : {0U, 1U, 2U, 3U, 4U, 6U}) {
      const double size = std::abs(phantom.values[n]);
      const double off = std::abs(found[n] - phantom.values[n]);
      // Of photons leaving anywhere a sixth say something of one direction.
      const double own_se = n == 0 ? 0 : std::sqrt(6 * std::abs(phantom.values[0]) / kPhotons);
      const double se = std::hypot(own_se, phantom.standard_errors[n] * (n == 0 ? 1 : 1.414));
      EXPECT_LT(off, (n == 0 ? 0.001 : 0.01) * size + 3 * se)
          << phantom.medium << " at cos " << phantom.cos_incidence << ", harmonic " << n;
      off2 += off * off;
      noise2 += se * se;
    }
  }
  EXPECT_LT(off2, 1.5 * noise2);
}

TEST(HalfSpaceTotals, AreThoseOfPhotonsThatAreCounted) {
  constexpr int kCount = 100'000;
  constexpr double kRatios[] = {0.02, 0.2};
  PhotonRandom random(5);
  double sum[2] = {}, sum2[2] = {};
  for (int photon = 0; photon < kCount; ++photon) {
    double left[2] = {};
    walk_photon(0, random, [&](const PhotonExit& exit) {
      for (std::size_t i = 0; i < 2; ++i)
        left[i] += exit.weight * std::exp(-kRatios[i] * exit.path_length);
    });
    for (std::size_t i = 0; i < 2; ++i) {
      sum[i] += left[i] / kCount;
      sum2[i] += left[i] * left[i] / kCount;
    }
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const double se = std::sqrt((sum2[i] - sum[i] * sum[i]) / kCount);
    EXPECT_LT(se, 0.006 * sum[i]);
    EXPECT_NEAR(half_space_totals(kRatios[i]).reflectance, sum[i], 3.5 * se);
  }
}

TEST(HalfSpaceTotals, SwappingTheDirectionsChangesNothingAndNextToNothingIsLost) {
  const HalfSpaceTotals totals = half_space_totals(0.05);
  for (const auto& order : totals.by_direction)
    for (std::size_t in = 0; in < kAngleNodes; ++in)
      for (std::size_t out = 0; out < in; ++out)
        EXPECT_NEAR(order[in][out], order[out][in], 1e-6 * totals.by_direction[0][in][out]);
  // Absorption takes its square root's share of white light: one constant at both.
  const double least = (1 - half_space_totals(1e-4).reflectance) / std::sqrt(1e-4);
  const double more = (1 - half_space_totals(4e-4).reflectance) / std::sqrt(4e-4);
  EXPECT_NEAR(least / more, 1, 0.06);
}

// design/estimation.md, section 1: the first harmonic of a 12 mm period on cheek, red. All exits.
TEST(ScatterTable, ObliqueLightComesOutShifted) {
  const double published_mm[] = {0.12, 0.25, 0.35, 0.43};
  const double degrees[] = {14, 30, 45, 60};
  for (std::size_t i = 0; i < 4; ++i) {
    const auto found = transform(
        over_all_exits(table().material(kCheek[0]), degrees[i] * kDegree, 24, 8), 1 / 12.0);
    EXPECT_NEAR(std::arg(found) / (2 * std::numbers::pi / 12), published_mm[i], 0.02) << degrees[i];
  }
}

TEST(ScatterTable, SwappingTheDirectionsChangesNothing) {
  for (const Scattering& medium : kCheek)
    for (const double a : {0.0, 30 * kDegree})
      for (const double b : {45 * kDegree, 60 * kDegree}) {
        const auto brightness = [&](double in, double out) {
          return (1 - fresnel_reflectance(std::cos(in), 1, kSkinIndex)) *
                 // Over the azimuths: the mean of two that are opposite has no odd orders.
                 (table().kernel(medium, {in, out, std::numbers::pi / 4}).total() +
                  table().kernel(medium, {in, out, std::numbers::pi * 3 / 4}).total() +
                  table().kernel(medium, {in, out, std::numbers::pi * 5 / 4}).total() +
                  table().kernel(medium, {in, out, std::numbers::pi * 7 / 4}).total()) /
                 4;
        };
        // Three standard errors: of the photons some leave near the angle that is looked at, within
        // a hat 0.35 rad wide on either side, all around.
        const auto se = [&](double out) {
          const double share = std::max(0.041, 0.35 * std::sin(2 * out));
          return 1 / std::sqrt(kPhotons * share * brightness(a, b));
        };
        EXPECT_NEAR(brightness(a, b) / brightness(b, a), 1, 3 * std::hypot(se(a), se(b)));
      }
}

TEST(ScatterTable, IsTheSameForAnyNumberOfThreadsAndFromItsFile) {
  const test_support::TemporaryFolder folder;
  const ScatterTable made = ScatterTable::cached(folder.path(), 1600, 9, {});
  const ScatterTable read =
      ScatterTable::cached(folder.path(), 1600, 9, [](double) { ADD_FAILURE() << "walked again"; });
  const SkinKernel a = made.kernel(kCheek[0], {0.3, 0.4, 0.5});
  const SkinKernel b = read.kernel(kCheek[0], {0.3, 0.4, 0.5});
  EXPECT_EQ(a.total(), b.total());
  EXPECT_EQ(a.at(0.3F, 0.1F, 0.5F), b.at(0.3F, 0.1F, 0.5F));
  EXPECT_GT(a.at(0.3F, 0.1F, 0.5F), 0);
}

// The world's picture of a flat phantom against the kernel summed over the plane ring by ring.
TEST(ScatterTable, AWorldSumsTheKernelOverItsSurface) {
  TestRig rig = make_test_rig(49, 36, 1);
  table();  // made, so that the world finds it
  SceneOptions options;
  options.name = "flat_phantom";
  options.has_indirect = false;
  options.scattering = ScatteringModel::kMonteCarlo;
  options.photons_per_angle = kPhotons;
  options.cache_folder = cache().path();
  options.thread_count = 2;
  const auto world = make_world(rig, options);
  ASSERT_TRUE(world);
  std::vector<Image<float>> shots;
  for (int shift = 0; shift < 40; ++shift)
    shots.push_back(world->linear_image(
        make_picture(rig, estimation::Stripes{estimation::Axis::kColumn, 40, 8, shift})));
  const Vec3 normal(0, 0, -1);
  const auto& calibration = rig.calibration;
  const Vec3 lamp = -(calibration.projector_from_camera.t() * calibration.projector_from_camera_mm);
  const double d0 = *calibration.irradiance->reference_distance_mm;
  const auto column_of = [&](const Vec3& point) {
    const Vec3 local =
        calibration.projector_from_camera * point + calibration.projector_from_camera_mm;
    return calibration.projector.K(0, 0) * local[0] / local[2] + calibration.projector.K(0, 2);
  };
  const int pixels[2][2] = {{18, 25}, {19, 25}};  // G, B
  for (const auto& [row, col] : pixels) {
    const auto band = static_cast<std::size_t>(estimation::band_at(rig.camera, row, col));
    const auto& K = calibration.camera.K;
    const Vec3 at(1000 * (col - K(0, 2)) / K(0, 0), 1000 * (row - K(1, 2)) / K(1, 1), 1000);
    const Vec3 to_lamp = (lamp - at) / cv::norm(lamp - at), to_eye = -at / cv::norm(at);
    const double cos_in = to_lamp.dot(normal);
    const Vec3 travel = cos_in * normal - to_lamp;
    const Vec3 along = travel / cv::norm(travel), across = normal.cross(along);
    const SkinKernel kernel =
        table().kernel(kCheek[band], {std::acos(cos_in), std::acos(to_eye.dot(normal)),
                                      std::atan2(to_eye.dot(across), to_eye.dot(along))});
    std::vector<double> by_column(1024, 0.0);
    constexpr int kSectors = 256;
    for (std::size_t knot = 0; knot < SkinKernel::kKnots; ++knot) {
      const SkinKernel::Ring ring = kernel.ring(knot);
      if (ring.radius_mm > 26) break;
      for (int sector = 0; sector < kSectors; ++sector) {
        const double angle = 2 * std::numbers::pi * (sector + 0.5) / kSectors;
        const double c = std::cos(angle), s = std::sin(angle);
        const Vec3 entry = at - ring.radius_mm * (c * along + s * across);
        const Vec3 back = lamp - entry;
        const double d = cv::norm(back);
        const double value = ring.terms[0] + c * ring.terms[1] + s * ring.terms[2] +
                             (c * c - s * s) * ring.terms[3] + 2 * c * s * ring.terms[4];
        by_column[static_cast<std::size_t>(std::lround(column_of(entry)))] +=
            value * ring.area_mm2 / kSectors * back.dot(normal) / d * (d0 / d) * (d0 / d) *
            (1 - fresnel_reflectance(cos_in, 1, kSkinIndex));
      }
    }
    for (const int n : {0, 1, 2, 3, 4, 6}) {
      std::complex<double> found = 0, expected = 0;
      for (int shift = 0; shift < 40; ++shift) {
        const auto wave = std::polar(1.0, 2 * std::numbers::pi * n * shift / 40) / 8.0;
        found += wave * static_cast<double>(shots[static_cast<std::size_t>(shift)].at(row, col)) /
                 calibration.irradiance->signal_per_us[band];
        for (int c = 0; c < 1024; ++c)
          if (((c - shift) % 40 + 40) % 40 < 8)
            expected += wave * by_column[static_cast<std::size_t>(c)];
      }
      EXPECT_NEAR(std::abs(found - expected), 0,
                  0.005 * std::abs(expected) + 2e-4)  // and the photons' noise between the rings
          << "band " << band << " harmonic " << n << ": " << found << " for " << expected;
    }
  }
}

}  // namespace
}  // namespace hw_sim
