// A session made by another writer (tests/estimation/session_example) from its files to maps: the
// errors against its truth, material by material, and live against disk.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "estimation/estimator.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

// Written by convert_truth.py from the session's truth.npz.
std::vector<float> truth(const std::string& name) {
  std::ifstream file(SSRIG_TEST_DATA "/session_example_truth/" + name + ".f32", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  std::vector<float> values(bytes.size() / sizeof(float));
  std::memcpy(values.data(), bytes.data(), values.size() * sizeof(float));
  return values;
}

// The session's truth is the dipole.
EstimatorOptions with_dipole(const std::string& method) {
  EstimatorOptions options;
  options.method = method;
  options.model = "dipole";
  return options;
}

SessionEstimate estimated(const std::string& method) {
  auto found = estimate_session(SSRIG_SESSION_EXAMPLE, with_dipole(method));
  EXPECT_TRUE(found) << found.error().text();
  return found ? std::move(*found) : SessionEstimate{};
}

const SessionEstimate& from_disk() {
  static const SessionEstimate found = estimated("likelihood");
  return found;
}

const SessionEstimate& by_table() {
  static const SessionEstimate found = estimated("lut");
  return found;
}

struct Spread {
  double median = 0;      // signed
  double median_abs = 0;  // of the absolute errors
  double p95 = 0;
  double valid_frac = 0;
};

Spread spread_of(std::vector<double> errors, std::size_t total) {
  Spread spread;
  spread.valid_frac = static_cast<double>(errors.size()) / static_cast<double>(total);
  if (errors.empty()) return spread;
  const auto middle = [](std::vector<double>& values) {
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
  };
  spread.median = middle(errors);
  for (double& error : errors) error = std::abs(error);
  spread.median_abs = middle(errors);
  spread.p95 = errors[errors.size() * 95 / 100];
  return spread;
}

constexpr int kMaterialCount = 3;
constexpr const char* kMaterial[kMaterialCount] = {"lips", "forehead", "cheek"};

// Relative errors of a band's map over one material.
Spread errors_over(const Image<float>& map, const std::vector<float>& values, int band,
                   int material) {
  const std::vector<float> region = truth("reg");
  std::vector<double> errors;
  std::size_t total = 0;
  for (std::size_t i = 0; i < region.size(); ++i) {
    if (static_cast<int>(region[i]) != material) continue;
    ++total;
    const double found = static_cast<double>(map.samples()[i]);
    const double expected = static_cast<double>(values[3 * i + static_cast<std::size_t>(band)]);
    if (std::isfinite(found)) errors.push_back(found / expected - 1);
  }
  return spread_of(std::move(errors), total);
}

// The session has indirect light B from 0 to 0.03 (median 0.015), for which the paper's method is
// biased: +7% of l_d at B = 0.02 for cheek red (design/estimation.md, section 3), that is about +5%
// in the median and twice that at the 95th percentile. The limits are that bias plus the noise and
// the pixels next to another material, which are counted.
struct Limit {
  double greatest_median = 0;      // of the signed errors
  double greatest_median_abs = 0;  // of the absolute errors
  double greatest_p95 = 0;
};

// Of l_d, R_d, sigma_a and sigma_s' in this order.
void expect_errors_within(const Maps& maps, const std::array<Limit, 4>& limits) {
  const std::array<std::pair<const char*, const BandMaps*>, 4> quantities = {
      {{"l_d", &maps.translucency_mm},
       {"R_d", &maps.diffuse_reflectance},
       {"sigma_a", &maps.sigma_a_per_mm},
       {"sigma_s", &maps.sigma_s_prime_per_mm}}};
  std::printf("%-8s %-9s %s %9s %9s %9s %6s\n", "map", "material", "band", "median", "|median|",
              "|p95|", "valid");
  for (std::size_t quantity = 0; quantity < quantities.size(); ++quantity) {
    const auto& [name, images] = quantities[quantity];
    const std::vector<float> values = truth(name);
    ASSERT_EQ(values.size(), 64U * 48U * 3U) << name;
    for (int material = 0; material < kMaterialCount; ++material)
      for (int band = 0; band < 3; ++band) {
        const Image<float>& map = (*images)[static_cast<std::size_t>(band)];
        ASSERT_FALSE(map.empty()) << name;
        const Spread spread = errors_over(map, values, band, material);
        std::printf("%-8s %-9s %c    %+8.2f%% %8.2f%% %8.2f%% %5.1f%%\n", name, kMaterial[material],
                    "RGB"[band], 100 * spread.median, 100 * spread.median_abs, 100 * spread.p95,
                    100 * spread.valid_frac);
        SCOPED_TRACE(::testing::Message() << name << " " << kMaterial[material] << " "
                                          << "RGB"[band]);
        EXPECT_LT(std::abs(spread.median), limits[quantity].greatest_median);
        EXPECT_LT(spread.median_abs, limits[quantity].greatest_median_abs);
        EXPECT_LT(spread.p95, limits[quantity].greatest_p95);
        EXPECT_GT(spread.valid_frac, 0.95);
      }
  }
}

TEST(SessionExample, ErrorsOfTheTableSearchAreThoseOfThePapersMethod) {
  expect_errors_within(by_table().maps,
                       {{{1, 0.07, 0.15}, {1, 0.035, 0.07}, {1, 0.10, 0.20}, {1, 0.03, 0.08}}});
}

// Bias below 0.5%; the median absolute error of a pixel is 0.67 standard deviations, 1.3 to 1.8% of
// sigma_a and 0.6 to 1.3% of sigma_s' for a plain Python version of the fit; next to another
// material more.
TEST(SessionExample, LikelihoodIsWithoutTheBias) {
  expect_errors_within(
      from_disk().maps,
      {{{0.005, 0.008, 0.06}, {0.005, 0.004, 0.04}, {0.005, 0.01, 0.07}, {0.005, 0.006, 0.05}}});
}

// Median share of the true indirect light that is found.
double indirect_share(const Maps& maps, std::size_t band) {
  const std::vector<float> expected = truth("bmap");
  std::vector<double> shares;
  const Image<float>& map = maps.indirect[band];
  for (std::size_t i = 0; i < expected.size(); ++i)
    if (expected[i] > 0.01F && std::isfinite(map.samples()[i]))
      shares.push_back(static_cast<double>(map.samples()[i] / expected[i]));
  return spread_of(shares, expected.size()).median;
}

TEST(SessionExample, IndirectLightIsFoundByTheLikelihoodAndInPartByTheTable) {
  for (std::size_t band = 0; band < 3; ++band) {
    const double by_likelihood = indirect_share(from_disk().maps, band);
    const double in_part = indirect_share(by_table().maps, band);
    std::printf("indirect, band %c: median share %.2f, by the table %.2f\n", "RGB"[band],
                by_likelihood, in_part);
    EXPECT_NEAR(by_likelihood, 1, 0.03);
    EXPECT_GT(in_part, 0.2);  // the rest passes for translucency
    EXPECT_LT(in_part, 1.0);
  }
}

TEST(SessionExample, SurfaceAndCorrespondenceAreThoseOfThePlane) {
  const Maps& maps = from_disk().maps;
  const std::vector<float> point = truth("X"), normal = truth("N"), u = truth("u");
  std::vector<double> depth_mm, angle_deg, u_px;
  for (std::size_t i = 0; i < u.size(); ++i) {
    if (!std::isfinite(maps.position_mm[2].samples()[i])) continue;
    depth_mm.push_back(static_cast<double>(maps.position_mm[2].samples()[i] - point[3 * i + 2]));
    u_px.push_back(static_cast<double>(maps.correspondence_px[0].samples()[i] - u[i]));
    double cosine = 0;
    for (std::size_t k = 0; k < 3; ++k)
      cosine += static_cast<double>(maps.normal[k].samples()[i] * normal[3 * i + k]);
    angle_deg.push_back(std::acos(std::min(cosine, 1.0)) * 57.29578);
  }
  const Spread depth = spread_of(depth_mm, u.size()), angle = spread_of(angle_deg, u.size()),
               shift = spread_of(u_px, u.size());
  std::printf("depth |median| %.4f mm, normal %.3f deg, column %.4f px, valid %.1f%%\n",
              depth.median_abs, angle.median_abs, shift.median_abs, 100 * depth.valid_frac);
  EXPECT_LT(depth.median_abs, 0.1);
  EXPECT_LT(angle.median_abs, 0.5);
  EXPECT_LT(shift.median_abs, 0.05);
  EXPECT_GT(depth.valid_frac, 0.95);
}

// What a live capture does: frames one by one, in the order the network gave them.
TEST(SessionExample, LiveInAnyOrderEqualsFromDiskToTheBit) {
  const auto manifest = read_manifest(SSRIG_SESSION_EXAMPLE);
  ASSERT_TRUE(manifest);
  EstimatorOptions options = with_dipole("likelihood");
  options.thread_count = 1;
  auto estimator = Estimator::create(*manifest, SSRIG_SESSION_EXAMPLE, options);
  ASSERT_TRUE(estimator);
  std::vector<std::size_t> order(manifest->frames.size());
  std::iota(order.begin(), order.end(), 0);
  std::mt19937_64 random(11);
  for (std::size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[random() % i]);
  for (const std::size_t i : order) {
    const auto frame = read_frame(SSRIG_SESSION_EXAMPLE, *manifest, manifest->frames[i].file);
    ASSERT_TRUE(frame);
    ASSERT_TRUE((*estimator)->add_frame(i, frame->view()));
  }
  const auto live = (*estimator)->finish();
  ASSERT_TRUE(live);
  const Maps& disk = from_disk().maps;
  const auto expect_equal = [](const auto& a, const auto& b) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      ASSERT_EQ(a[i].samples().size(), b[i].samples().size());
      if (!a[i].empty()) {
        EXPECT_EQ(
            std::memcmp(a[i].samples().data(), b[i].samples().data(), a[i].samples().size_bytes()),
            0);
      }
    }
  };
  expect_equal(live->sigma_a_per_mm, disk.sigma_a_per_mm);
  expect_equal(live->sigma_s_prime_per_mm, disk.sigma_s_prime_per_mm);
  expect_equal(live->translucency_mm, disk.translucency_mm);
  expect_equal(live->diffuse_reflectance, disk.diffuse_reflectance);
  expect_equal(live->indirect, disk.indirect);
  expect_equal(live->sigma_a_rel_sd, disk.sigma_a_rel_sd);
  expect_equal(live->indirect_sd, disk.indirect_sd);
  expect_equal(live->position_mm, disk.position_mm);
  expect_equal(live->normal, disk.normal);
  expect_equal(live->correspondence_px, disk.correspondence_px);
  expect_equal(live->correspondence_sd_px, disk.correspondence_sd_px);
  expect_equal(live->validity, disk.validity);
}

TEST(SessionExample, ProgressEndsWithEverythingDone) {
  std::map<std::string, EstimateProgress> last;
  ASSERT_TRUE(estimate_session(SSRIG_SESSION_EXAMPLE, {}, [&](const EstimateProgress& progress) {
    last[progress.stage] = progress;
  }));
  EXPECT_EQ(last["frames"].done, 176U);
  EXPECT_EQ(last["frames"].total, 176U);
  EXPECT_EQ(last["maps"].done, 1U);
}

TEST(SessionExample, AFolderWithoutASessionIsAnError) {
  EXPECT_FALSE(estimate_session("/nonexistent/session", {}));
}

}  // namespace
}  // namespace estimation
