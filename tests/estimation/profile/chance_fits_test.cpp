// Verdicts by the neighbourhood, over fits whose standard deviations are made up.
#include "estimation/profile/chance_fits.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <vector>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr int kSide = 15;
constexpr std::uint32_t kUntold = kNotIdentifiable, kDark = kTooDark;

// All pixels of a small mono frame; of every `period` the first `untold` do not know l_d.
struct Field {
  CameraInfo camera;
  SiteFits fits;

  Field(int untold, int period, float log_sd) {
    camera.width_px = camera.height_px = kSide;
    camera.pixel_format.filter = ColorFilter::kMono;
    fits.fit.resize(240);
    for (int i = 0; i < kSide * kSide; ++i) {
      fits.sites.push_back({i / kSide, i % kSide});
      fits.fit.validity[static_cast<std::size_t>(i)] = i % period < untold ? kUntold : 0U;
      set_log_sd(i, log_sd);
    }
  }

  void set_log_sd(int site, float sd) {
    fits.fit.covariance[covariance_index(1, 1) * fits.fit.stride + static_cast<std::size_t>(site)] =
        sd * sd;
  }
  float log_variance(std::size_t site) const {
    return fits.fit.covariance[covariance_index(1, 1) * fits.fit.stride + site];
  }
  std::ptrdiff_t valid_count() const {
    return std::count(fits.fit.validity.begin(), fits.fit.validity.begin() + kSide * kSide, 0U);
  }
};

TEST(ChanceFits, FewAmongManyUntoldAreRefused) {
  Field field(4, 5, 0.25F);
  EXPECT_EQ(judge_vague_fits(field.camera, field.fits), 45U);
  EXPECT_EQ(field.valid_count(), 0);
}

TEST(ChanceFits, ManyAmongFewUntoldStayAsTheyAre) {
  Field field(1, 8, 0.4F);
  const std::vector<float> before = field.fits.fit.covariance;
  EXPECT_EQ(judge_vague_fits(field.camera, field.fits), 0U);
  EXPECT_EQ(field.valid_count(), 196);
  EXPECT_EQ(field.fits.fit.covariance, before);
}

// Three quarters told: 1 + 4 (0.85 - 0.75).
TEST(ChanceFits, InBetweenTheyStateLargerVariances) {
  Field field(1, 4, 0.4F);
  field.set_log_sd(1, 0.08F);  // known well: as it is
  EXPECT_EQ(judge_vague_fits(field.camera, field.fits), 0U);
  EXPECT_EQ(field.valid_count(), 168);
  EXPECT_NEAR(field.log_variance(2), 1.4 * 0.16, 0.02);
  EXPECT_FLOAT_EQ(field.log_variance(1), 0.08F * 0.08F);
}

TEST(ChanceFits, WhatIsKnownWellStaysAmongUntold) {
  Field field(4, 5, 0.25F);
  field.set_log_sd(4, 0.08F);
  EXPECT_EQ(judge_vague_fits(field.camera, field.fits), 44U);
  EXPECT_EQ(field.fits.fit.validity[4], 0U);
}

// Pixels without light say nothing about the others.
TEST(ChanceFits, DarkNeighboursDoNotCount) {
  Field field(4, 5, 0.25F);
  std::replace(field.fits.fit.validity.begin(), field.fits.fit.validity.end(), kUntold, kDark);
  EXPECT_EQ(judge_vague_fits(field.camera, field.fits), 0U);
  EXPECT_EQ(field.valid_count(), 45);
}

}  // namespace
}  // namespace estimation
