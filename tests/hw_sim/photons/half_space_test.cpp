// Photons through flat phantoms against another Monte Carlo code and the laws of nature. Few
// photons: tolerances are those of their standard errors. Many: tests/bench, photon-windows.
#include "tests/hw_sim/photons/half_space.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "tests/hw_sim/photons/flat_harmonics.h"

namespace hw_sim {
namespace {

using estimation::Vec3;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kFromLeft = std::numbers::pi;  // azimuth: light travels along x
constexpr Scattering kCheekRed{0.0525, 1.2814}, kClearSkin{0.013, 1.09};

TEST(HalfSpacePhotons, HarmonicsAreThoseOfAnotherMonteCarloCode) {
  const auto media = read_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv");
  ASSERT_EQ(media.size(), 8U);
  constexpr std::size_t kFreqs = std::size(kTruthFreqs_per_mm);
  std::array<double, kFreqs> off{}, variance{};  // of all media together
  for (const TruthMedium& medium : media) {
    const auto found =
        flat_harmonics(volume_optics(medium.scattering), {}, kTruthFreqs_per_mm, 16000, 11);
    ASSERT_EQ(medium.reflectance.size(), kFreqs);
    for (std::size_t i = 0; i < kFreqs; ++i) {
      // The file's are per flux that enters.
      const double expected = medium.reflectance[i] * (1 - fresnel_reflectance(1, 1, kSkinIndex));
      const double se = std::hypot(found[i].standard_error, medium.standard_error[i]);
      // Four: there are 48 of them.
      EXPECT_NEAR(found[i].value.real(), expected, (i == 0 ? 0.005 : 0.01) * expected + 4 * se)
          << medium.name << " at " << kTruthFreqs_per_mm[i] << "/mm";
      EXPECT_LT(found[i].standard_error, 0.03 * medium.reflectance[0]);
      off[i] += found[i].value.real() - expected;
      variance[i] += se * se;
    }
  }
  for (std::size_t i = 0; i < kFreqs; ++i)
    EXPECT_LT(std::abs(off[i]), 3.5 * std::sqrt(variance[i])) << "at " << kTruthFreqs_per_mm[i];
}

// design/estimation.md, section 1: the first harmonic of a 12 mm period on cheek, red.
TEST(HalfSpacePhotons, ObliqueLightComesOutShifted) {
  const double published_mm[] = {0.12, 0.25, 0.35};
  const double degrees[] = {14, 30, 45};
  const double freq_per_mm[] = {1 / 12.0};
  for (std::size_t i = 0; i < std::size(degrees); ++i) {
    const Harmonic first = flat_harmonics(
        volume_optics(kCheekRed),
        {.towards_lamp = outward(degrees[i] * kDegree, kFromLeft), .towards_eye = {}}, freq_per_mm,
        32000, 21)[0];
    const double per_rad_mm = 12 / (2 * std::numbers::pi);
    const double shift_mm = -std::arg(first.value) * per_rad_mm;
    const double se_mm = first.standard_error / std::abs(first.value) * per_rad_mm;
    EXPECT_NEAR(shift_mm, published_mm[i], 0.005 + 3.5 * se_mm) << degrees[i] << " degrees";
    EXPECT_LT(se_mm, 0.03);
  }
}

// Every deposit at its own place, no symmetry used: real and imaginary part.
std::array<Estimate, 2> plain_harmonic(const VolumeOptics& optics, const FlatView& view,
                                       double freq_per_mm, int paths) {
  constexpr int kBatches = 16;
  const UniformMatter matter(optics);
  const AdjointWalk walk(half_space(), matter, sunlight(view.towards_lamp));
  std::array<std::vector<double>, 2> parts;
  std::vector<Deposit> deposits;
  for (int batch = 0; batch < kBatches; ++batch) {
    PhotonRandom random(51 + static_cast<std::uint64_t>(batch));
    std::complex<double> sum = 0;
    for (int path = 0; path < paths / kBatches; ++path) {
      deposits.clear();
      const Vec3 eye = view.towards_eye ? *view.towards_eye : lambertian_direction(random);
      const auto start = seen_path(half_space(), {0, 0, 0}, eye);
      if (start) walk.trace(*start, random, deposits);
      for (const Deposit& deposit : deposits)
        sum += std::polar(deposit.weight, 2 * std::numbers::pi * freq_per_mm * deposit.entry_mm[0]);
    }
    sum *= kBatches / (-view.towards_lamp[2] * paths);
    parts[0].push_back(sum.real());
    parts[1].push_back(sum.imag());
  }
  return {estimate_of(parts[0]), estimate_of(parts[1])};
}

TEST(HalfSpacePhotons, ForgottenAzimuthsTakeTheNoiseAndLeaveTheMean) {
  const FlatView views[] = {
      {},
      {.towards_lamp = outward(50 * kDegree, kFromLeft), .towards_eye = {}},
      {.towards_lamp = outward(50 * kDegree, kFromLeft), .towards_eye = outward(0.6, 0.7)}};
  constexpr int kPaths = 6400;
  for (const FlatView& view : views)
    for (const double freq_per_mm : {0.1, 0.5}) {
      SCOPED_TRACE(freq_per_mm);
      const auto optics = volume_optics(kClearSkin);  // light goes far
      const auto plain = plain_harmonic(optics, view, freq_per_mm, kPaths);
      const Harmonic found = flat_harmonics(optics, view, {&freq_per_mm, 1}, kPaths, 71)[0];
      EXPECT_NEAR(found.value.real(), plain[0].value,
                  3.5 * std::hypot(plain[0].standard_error, found.standard_error));
      EXPECT_NEAR(found.value.imag(), plain[1].value,
                  3.5 * std::hypot(plain[1].standard_error, found.standard_error));
      if (freq_per_mm == 0.5 && view.towards_lamp[0] == 0) {
        EXPECT_LT(found.standard_error, 0.75 * plain[0].standard_error);
      }
    }
}

// From one medium into another: matter that varies in sigma_a, sigma_s and g, along x.
class Gradual final : public Matter {
 public:
  Gradual(const VolumeOptics& left, const VolumeOptics& right) : left_(left), right_(right) {}
  VolumeOptics at(const Vec3& point_mm) const override {
    const double share = 0.5 + 0.5 * std::tanh(point_mm[0] / 0.4);
    const auto mixed = [&](double a, double b) { return a + share * (b - a); };
    return {mixed(left_.sigma_a_per_mm, right_.sigma_a_per_mm),
            mixed(left_.sigma_s_per_mm, right_.sigma_s_per_mm),
            mixed(left_.anisotropy, right_.anisotropy)};
  }
  double greatest_sigma_t_per_mm() const override {
    return std::max(left_.sigma_t_per_mm(), right_.sigma_t_per_mm());
  }

 private:
  VolumeOptics left_, right_;
};

constexpr VolumeOptics kForward{0.0525, 6.4, 0.8}, kIsotropic{0.4, 0.9, 0};

// Light that enters within [low, high] and leaves between [from, to] along x, seen from `exit_rad`.
Estimate passed(const Matter& matter, double incidence_rad, double exit_rad, double low,
                double high, double from, double to, int paths) {
  constexpr int kBatches = 16;
  const AdjointWalk walk(half_space(), matter, sunlight(outward(incidence_rad, kFromLeft)));
  std::vector<double> batches;
  std::vector<Deposit> deposits;
  for (int batch = 0; batch < kBatches; ++batch) {
    PhotonRandom random(31 + static_cast<std::uint64_t>(batch));
    double sum = 0;
    for (int path = 0; path < paths / kBatches; ++path) {
      deposits.clear();
      const Vec3 seen(from + (to - from) * random.uniform(), 0, 0);
      const auto start = seen_path(half_space(), seen, outward(exit_rad, kFromLeft));
      walk.trace(*start, random, deposits);
      for (const Deposit& deposit : deposits)
        if (deposit.entry_mm[0] >= low && deposit.entry_mm[0] < high) sum += deposit.weight;
    }
    batches.push_back(sum * kBatches / paths / std::cos(incidence_rad));
  }
  return estimate_of(batches);
}

TEST(HalfSpacePhotons, LightAndEyeMayChangePlaces) {
  const Gradual matter(kForward, kIsotropic);
  constexpr int kPaths = 32000;
  const Estimate there = passed(matter, 50 * kDegree, 0, 0, 1.5, -1.5, 0, kPaths);
  const Estimate back = passed(matter, 0, 50 * kDegree, -1.5, 0, 0, 1.5, kPaths);
  const double se = std::hypot(there.standard_error, back.standard_error);
  EXPECT_GT(there.value, 0.01);
  EXPECT_LT(se, 0.04 * there.value);
  EXPECT_NEAR(there.value, back.value, 3.5 * se);
}

TEST(HalfSpacePhotons, FarFromABorderEachMediumIsItself) {
  const Gradual matter(kForward, kIsotropic);
  for (const bool is_left : {true, false}) {
    const VolumeOptics& own = is_left ? kForward : kIsotropic;
    const double x = is_left ? -12 : 12;
    const Estimate here = passed(matter, 0, 0.3, -1e3, 1e3, x, x, 16000);
    const Estimate alone = passed(UniformMatter(own), 0, 0.3, -1e3, 1e3, x, x, 16000);
    EXPECT_NEAR(here.value, alone.value,
                3.5 * std::hypot(here.standard_error, alone.standard_error));
  }
  // The two differ by far more than that.
  EXPECT_GT(passed(UniformMatter(kForward), 0, 0.3, -1e3, 1e3, 0, 0, 16000).value,
            2 * passed(UniformMatter(kIsotropic), 0, 0.3, -1e3, 1e3, 0, 0, 16000).value);
}

// Without absorption what goes in comes out: all of what a small ball's boundary lets in of
// parallel light, by way of its curvature, total reflection inside and all.
TEST(BallPhotons, NothingIsLostWithoutAbsorption) {
  const auto ball = make_sphere({0, 0, 0}, 1);
  const ShapeGrid grid(*ball, {{-1.2, -1.2, -1.2}, {1.2, 1.2, 1.2}}, 0.04);
  const UniformMatter white({0, 7.5, 0.8});
  const AdjointWalk walk(grid, white, sunlight({0, 0, -1}));
  double transmitted = 0;  // of light by Lambert's law
  constexpr int kSteps = 2000;
  for (int i = 0; i < kSteps; ++i)
    transmitted += (1 - fresnel_reflectance(std::sqrt((i + 0.5) / kSteps), 1, kSkinIndex)) / kSteps;
  std::vector<double> batches;
  std::vector<Deposit> deposits;
  for (std::uint64_t batch = 0; batch < 16; ++batch) {
    PhotonRandom random(41 + batch);
    double sum = 0;
    constexpr int kPaths = 2000;
    for (int path = 0; path < kPaths; ++path) {
      // A random place, and a way to the eye by Lambert's law: the sum of both unit vectors.
      const auto place = deflected({0, 0, 1}, 2 * random.uniform() - 1, random);
      const auto turn = deflected({0, 0, 1}, 2 * random.uniform() - 1, random);
      const Vec3 normal(place[0], place[1], place[2]);
      Vec3 towards_eye = normal + Vec3(turn[0], turn[1], turn[2]);
      towards_eye /= cv::norm(towards_eye);
      deposits.clear();
      const auto start = seen_path(grid, normal, towards_eye);
      if (!start) continue;
      const PathEnd end = walk.trace(*start, random, deposits);
      EXPECT_DOUBLE_EQ(end.weight, start->weight);  // every path comes out, whole
      for (const Deposit& deposit : deposits) sum += deposit.weight / kPaths;
    }
    batches.push_back(sum);
  }
  const Estimate found = estimate_of(batches);
  // A disc's light over a sphere's surface. The grid rounds the ball by 0.02% of its radius.
  EXPECT_LT(found.standard_error, 0.015 * found.value);
  EXPECT_NEAR(found.value, transmitted / 4, 0.002 * found.value + 3.5 * found.standard_error);
}

}  // namespace
}  // namespace hw_sim
