// The white Monte Carlo walk against exact answers, within its own standard error.
#include "estimation/models/monte_carlo/photon_walk.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

#include "estimation/models/monte_carlo/single_scattering.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {
namespace {

// Where a true deviation and chance part: one run in 2000 deviates by more.
constexpr double kStandardErrors = 3.5;

struct Estimate {
  double mean = 0, standard_error = 0;
};

void expect_estimates(const Estimate& estimate, double exact) {
  EXPECT_NEAR(estimate.mean, exact, kStandardErrors * estimate.standard_error);
  std::printf("%.6f +- %.6f, exact %.6f (%+.1f se)\n", estimate.mean, estimate.standard_error,
              exact, (estimate.mean - exact) / estimate.standard_error);
}

// The mean over photons of the sum of score(exit) over a photon's exits.
Estimate average(const PhotonWalk& walk, int photon_count,
                 const std::function<double(const PhotonExit&)>& score) {
  RandomStream random(20, 1);
  double sum = 0, squares = 0;
  for (int i = 0; i < photon_count; ++i) {
    double photon = 0;
    walk.launch(Direction3{}, random, [&](const PhotonExit& exit) { photon += score(exit); });
    sum += photon;
    squares += photon * photon;
  }
  const double mean = sum / photon_count;
  return {mean, std::sqrt((squares / photon_count - mean * mean) / photon_count)};
}

Estimate reflectance(const WalkMedium& medium, double absorption, int photon_count) {
  // Beyond this the light is below exp(-20).
  const PhotonWalk walk(medium, {20 / absorption, 4});
  return average(walk, photon_count, [&](const PhotonExit& exit) {
    return exit.weight * std::exp(-absorption * exit.path_tmfp);
  });
}

TEST(PhotonWalk, MatchedIsotropicHalfSpaceReflectsAsChandrasekharSays) {
  // 1 - H(1) sqrt(1 - w), design/science.md.
  struct Anchor {
    double albedo, reflectance;
  };
  for (const Anchor& anchor : std::vector<Anchor>{{.5, .115226},
                                                  {.8, .285255},
                                                  {.9, .414947},
                                                  {.95, .535541},
                                                  {.99, .752721},
                                                  {.999, .912845}}) {
    SCOPED_TRACE(::testing::Message() << "albedo " << anchor.albedo);
    const WalkMedium medium{.eta = 1, .anisotropy = 0};
    expect_estimates(reflectance(medium, (1 - anchor.albedo) / anchor.albedo, 300'000),
                     anchor.reflectance);
  }
}

TEST(PhotonWalk, SlabReflectsAndTransmitsAsPublished) {
  // n 1, mu_a 10/cm, mu_s 90/cm, g 0.75, 0.02 cm thick (van de Hulst); mu_s' is 22.5/cm.
  const PhotonWalk walk({.eta = 1, .anisotropy = 0.75, .thickness_tmfp = 0.02 * 22.5}, {1000});
  const auto through = [](bool bottom) {
    return [bottom](const PhotonExit& exit) {
      return exit.through_bottom == bottom ? exit.weight * std::exp(-10 / 22.5 * exit.path_tmfp)
                                           : 0.0;
    };
  };
  expect_estimates(average(walk, 500'000, through(false)), 0.09739);
  expect_estimates(average(walk, 500'000, through(true)), 0.66096);
}

TEST(PhotonWalk, MismatchedHalfSpaceReflectsAsPublished) {
  // n 1.5, mu_a 10, mu_s 90, isotropic (Giovanelli): 0.2600 with the specular 0.04.
  const Estimate inside = reflectance({.eta = 1.5, .anisotropy = 0}, 10.0 / 90, 500'000);
  expect_estimates({0.04 + 0.96 * inside.mean, 0.96 * inside.standard_error}, 0.2600);
}

TEST(PhotonWalk, LightScatteredOnceLeavesAsTheIntegralSays) {
  for (const WalkMedium& medium : {WalkMedium{1.4, 0.8}, WalkMedium{1.5, 0}, WalkMedium{1, -0.3}}) {
    const SingleScattering single(medium);
    const PhotonWalk walk(medium, {20});
    for (const double absorption : {0.0, 0.5, 5.0}) {
      for (const double k_tmfp : {0.0, 1.0, 10.0}) {
        SCOPED_TRACE(::testing::Message() << "eta " << medium.eta << " g " << medium.anisotropy
                                          << " x " << absorption << " k " << k_tmfp);
        const Estimate once = average(walk, 30'000, [&](const PhotonExit& exit) {
          if (exit.scatter_count != 1) return 0.0;
          return exit.weight * std::exp(-absorption * exit.path_tmfp) *
                 std::cyl_bessel_j(0.0, k_tmfp * std::hypot(exit.x_tmfp, exit.y_tmfp));
        });
        EXPECT_NEAR(single.transform(absorption, k_tmfp), once.mean,
                    kStandardErrors * once.standard_error);
      }
    }
    EXPECT_NEAR(single.flux_between(0.5, 0, 0.6) + single.flux_between(0.5, 0.6, 1),
                single.transform(0.5, 0), 1e-7 * single.transform(0.5, 0));
  }
}

TEST(PhotonWalk, AllWeightLeavesOrIsLeft) {
  for (const double roulette_path_tmfp : {2.0, std::numeric_limits<double>::infinity()}) {
    const PhotonWalk walk({1.4, 0.8}, {100, roulette_path_tmfp});
    RandomStream random(4, 4);
    double sum = 0, squares = 0;
    constexpr int kPhotons = 20'000;
    for (int i = 0; i < kPhotons; ++i) {
      double out = 0;
      const double left =
          walk.launch(Direction3{}, random, [&](const PhotonExit& exit) { out += exit.weight; });
      sum += out + left;
      squares += (out + left) * (out + left);
    }
    const double mean = sum / kPhotons;
    EXPECT_NEAR(mean, 1,
                kStandardErrors * std::sqrt((squares / kPhotons - mean * mean) / kPhotons));
  }
}

TEST(PhotonWalk, ExitsComeInOrderAndNoCloserThanLightGoes) {
  const WalkMedium medium{1.4, 0.8};
  const PhotonWalk walk(medium, {200, 4});
  RandomStream random(6, 0);
  int exits = 0;
  for (int i = 0; i < 5'000; ++i) {
    double path_tmfp = 0;
    const Direction3 oblique = refracted_into(medium.eta, 0.5, 0.3);
    walk.launch(oblique, random, [&](const PhotonExit& exit) {
      ++exits;
      EXPECT_GE(exit.path_tmfp, path_tmfp);
      path_tmfp = exit.path_tmfp;
      EXPECT_LE(std::hypot(exit.x_tmfp, exit.y_tmfp), exit.path_tmfp * (1 + 1e-12));
      EXPECT_LE(exit.path_tmfp, 200);
      EXPECT_LT(exit.inside.z, 0);
      EXPECT_NEAR(std::hypot(exit.inside.x, exit.inside.y, exit.inside.z), 1, 1e-9);
      // Snell.
      EXPECT_NEAR(medium.eta * std::hypot(exit.inside.x, exit.inside.y),
                  std::sqrt(1 - exit.cos_outside * exit.cos_outside), 1e-9);
      EXPECT_GT(exit.weight, 0);
    });
  }
  EXPECT_GT(exits, 2'000);
}

TEST(PhotonWalk, FresnelIsExact) {
  EXPECT_NEAR(transmitted_frac(1.4, 1), 1 - std::pow(0.4 / 2.4, 2), 1e-15);
  EXPECT_NEAR(transmitted_frac(1.4, std::cos(M_PI / 4)), 0.963, 5e-4);  // design/estimation.md
  EXPECT_NEAR(transmitted_frac(1.4, 0.5), 0.928, 5e-4);
  EXPECT_EQ(transmitted_frac(1.4, 0), 0);
  EXPECT_EQ(transmitted_frac(1.4, -0.1), 0);
  EXPECT_EQ(inner_reflection(1.4, 0.69).reflected_frac, 1);  // below the critical 0.69985
  EXPECT_LT(inner_reflection(1.4, 0.71).reflected_frac, 1);
  EXPECT_EQ(inner_reflection(1, 0.1).reflected_frac, 0);
  // The same part passes in both directions.
  const Direction3 inside = refracted_into(1.4, 0.6, 1.0);
  EXPECT_NEAR(1 - inner_reflection(1.4, inside.z).reflected_frac, transmitted_frac(1.4, 0.6),
              1e-15);
  EXPECT_NEAR(inner_reflection(1.4, inside.z).cos_outside, 0.6, 1e-12);
  EXPECT_NEAR(std::atan2(inside.y, inside.x), 1.0, 1e-15);
}

TEST(RandomStream, StreamsOfASeedRepeatAndDiffer) {
  RandomStream a(1, 0), again(1, 0), next(1, 1), other(2, 0);
  double sum = 0;
  for (int i = 0; i < 1000; ++i) {
    const std::uint64_t bits = a.bits();
    EXPECT_EQ(bits, again.bits());
    EXPECT_NE(bits, next.bits());
    EXPECT_NE(bits, other.bits());
    sum += a.uniform() + 0 * again.uniform() + 0 * next.uniform() + 0 * other.uniform();
  }
  EXPECT_NEAR(sum / 1000, 0.5, kStandardErrors * std::sqrt(1.0 / 12 / 1000));
}

TEST(BesselJ0, IsWithinAMillionth) {
  double worst = 0;
  for (int i = 0; i < 60'000; ++i) {
    const double z = 0.0067 * i;
    worst = std::max(worst, std::abs(bessel_j0(z) - std::cyl_bessel_j(0.0, z)));
  }
  EXPECT_LT(worst, 1e-6);
}

}  // namespace
}  // namespace estimation
