// Scenes put through the estimator, and how close the maps come to their truth.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "estimation/estimator.h"
#include "tests/estimation/profile/synthetic_session.h"

namespace estimation::testing {

struct Estimate {
  Maps maps;
  std::vector<std::string> notes;
  std::vector<ProfilePoint> profiles;
};

// The scenes' truth is the dipole.
inline EstimatorOptions with_dipole(const std::string& method = "likelihood") {
  EstimatorOptions options;
  options.model = "dipole";
  options.method = method;
  return options;
}

inline Estimate estimate(const Scene& scene, const EstimatorOptions& options = with_dipole(),
                         const std::filesystem::path& session = {}, bool is_shuffled = false) {
  auto estimator = Estimator::create(scene.manifest, session, options);
  EXPECT_TRUE(estimator) << estimator.error().text();
  if (!estimator) return {};
  std::vector<std::size_t> order(scene.frames.size());
  std::iota(order.begin(), order.end(), 0);
  std::mt19937_64 random(7);
  for (std::size_t i = order.size(); is_shuffled && i > 1; --i)
    std::swap(order[i - 1], order[random() % i]);
  for (const std::size_t i : order) {
    const auto added = (*estimator)->add_frame(i, scene.frames[i].view());
    EXPECT_TRUE(added) << added.error().text();
  }
  auto maps = (*estimator)->finish();
  EXPECT_TRUE(maps) << maps.error().text();
  if (!maps) return {};
  return {std::move(*maps), (*estimator)->notes(), (*estimator)->profiles()};
}

// 95th percentile of |map / truth - 1| away from the border, where the surface is smoothed
// one-sided.
inline double error_frac(const Image<float>& map, double truth) {
  constexpr int kBorderPx = 5;
  std::vector<double> errors;
  for (int row = kBorderPx; row < map.height_px() - kBorderPx; ++row)
    for (int col = kBorderPx; col < map.width_px() - kBorderPx; ++col) {
      const double error = std::abs(static_cast<double>(map.at(row, col)) / truth - 1);
      errors.push_back(std::isnan(error) ? 1e9 : error);
    }
  std::sort(errors.begin(), errors.end());
  return errors[errors.size() * 95 / 100];
}

inline void expect_recovered(const Scene& scene, const Maps& maps, double tolerance_frac = 0.01) {
  for (std::size_t band = 0; band < static_cast<std::size_t>(maps.band_count); ++band) {
    SCOPED_TRACE(::testing::Message() << "band " << band);
    ASSERT_FALSE(maps.translucency_mm[band].empty());
    EXPECT_LT(error_frac(maps.translucency_mm[band], scene.l_d_mm[band]), tolerance_frac);
    EXPECT_LT(error_frac(maps.diffuse_reflectance[band], scene.reflectance[band]), tolerance_frac);
    EXPECT_LT(error_frac(maps.sigma_a_per_mm[band], scene.medium[band].sigma_a_per_mm),
              2 * tolerance_frac);
    EXPECT_LT(error_frac(maps.sigma_s_prime_per_mm[band], scene.medium[band].sigma_s_prime_per_mm),
              2 * tolerance_frac);
  }
}

inline bool any_contains(const std::vector<std::string>& notes, const std::string& word) {
  return std::any_of(notes.begin(), notes.end(),
                     [&](const std::string& note) { return note.find(word) != std::string::npos; });
}

}  // namespace estimation::testing
