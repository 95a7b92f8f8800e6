// The model monte_carlo against independent codes: MCML's table and adding and doubling.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "estimation/models/monte_carlo/photon_walk.h"
#include "estimation/models/monte_carlo/white_score.h"
#include "tests/estimation/models/shipped_model.h"

namespace estimation {
namespace {

using testing::s_of;
using testing::shipped;

// Rows of mc_truth_rf.csv, one medium.
struct Truth {
  Coefficients medium;
  double photon_count = 0;
  std::vector<double> freq_per_mm, reflectance;
};

std::map<std::string, Truth> read_truth() {
  std::map<std::string, Truth> media;
  std::ifstream file(std::string(SSRIG_TEST_DATA) + "/mc_truth_rf.csv");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("#") || line.starts_with("name")) continue;
    std::istringstream cells(line);
    std::string name, cell;
    std::getline(cells, name, ',');
    std::vector<double> numbers;
    while (std::getline(cells, cell, ',')) numbers.push_back(std::stod(cell));
    Truth& truth = media[name];
    truth.medium = {numbers[0], numbers[1]};
    truth.photon_count = numbers[2];
    truth.freq_per_mm.push_back(numbers[3]);
    truth.reflectance.push_back(numbers[4]);
  }
  return media;
}

// The relative standard error of each row: from the scatter of single photons in a run of ours, at
// that row's photon count. MCML lets a photon go or reflects it at the boundary, where we split it,
// so the square of its score comes with our weight, not its square; and it takes w =
// sigma_s/sigma_t a scattering on free paths of sigma_t, so that square is w^(2n), over paths w^-n
// exp(-x L) times as likely as ours.
std::vector<double> standard_errors(const Truth& truth) {
  constexpr int kPhotons = 20'000;
  const double x = truth.medium.sigma_a_per_mm / truth.medium.sigma_s_prime_per_mm;
  const double albedo = 1 / (1 + x * (1 - 0.8));
  std::vector<double> squares(truth.freq_per_mm.size());
  const PhotonWalk walk({1.4, 0.8}, {10 / x});
  RandomStream random(12, 0);
  for (int i = 0; i < kPhotons; ++i)
    walk.launch(Direction3{}, random, [&](const PhotonExit& exit) {
      const double r_mm = std::hypot(exit.x_tmfp, exit.y_tmfp) / truth.medium.sigma_s_prime_per_mm;
      const double weight = exit.weight * std::exp(-x * exit.path_tmfp) *
                            std::pow(albedo, static_cast<double>(exit.scatter_count));
      for (std::size_t f = 0; f < squares.size(); ++f) {
        const double phase = bessel_j0(2 * std::numbers::pi * truth.freq_per_mm[f] * r_mm);
        squares[f] += weight * phase * phase / kPhotons;
      }
    });
  std::vector<double> errors;
  for (std::size_t f = 0; f < squares.size(); ++f) {
    const double mean = truth.reflectance[f];
    const double photon_noise = std::sqrt((squares[f] - mean * mean) / truth.photon_count) / mean;
    errors.push_back(std::hypot(photon_noise, 0.001));
  }
  return errors;
}

// 0.5% up to 0.2/mm, as far as the file itself is as good, and three of its standard errors beyond.
// In four rows it is not: skin1_red, 0.17 to 0.20/mm, is 0.53 to 0.61% from our table. A third code
// (a textbook analog walk, 2.5e7 photons) has 0.068564 +- 0.000053 at 0.20/mm, the file 0.068867,
// we 0.068446 +- 0.000024. It is not our table's interpolation: our walk of this very medium (1e7
// photons) has 0.068428 +- 0.000082; from that the file is 2.9 of both standard errors away, its
// own being 0.00013 (0.19%), and from 0.17 to 0.20/mm all rows err together.
TEST(MonteCarlo, AgreesWithAnIndependentCode) {
  const MonteCarlo model = shipped("eta1.4_g0.8.txt");
  const std::map<std::string, Truth> media = read_truth();
  ASSERT_EQ(media.size(), 8u);
  int beyond_half_percent = 0;
  for (const auto& [name, truth] : media) {
    const std::vector<double> errors = standard_errors(truth);
    double worst_near = 0, worst_pull = 0, worst_far = 0;
    for (std::size_t i = 0; i < errors.size(); ++i) {
      const double f = truth.freq_per_mm[i];
      const double k_tmfp = 2 * std::numbers::pi * f / truth.medium.sigma_s_prime_per_mm;
      const double deviation =
          model.transform_at(s_of(truth.medium), k_tmfp) / truth.reflectance[i] - 1;
      SCOPED_TRACE(::testing::Message() << name << " f " << f << "/mm, its error " << errors[i]);
      if (f < 0.2 + 1e-9) {
        EXPECT_LT(std::abs(deviation), std::max(0.005, 3 * errors[i]));
        beyond_half_percent += std::abs(deviation) > 0.005;
        worst_near = std::max(worst_near, std::abs(deviation));
      } else {
        EXPECT_LT(std::abs(deviation), 3 * errors[i]);
        worst_far = std::max(worst_far, std::abs(deviation));
      }
      worst_pull = std::max(worst_pull, std::abs(deviation) / errors[i]);
    }
    std::printf(
        "%-14s worst to 0.2/mm %.2f%%, beyond %.2f%%; worst pull %.1f; its error %.2f%% at "
        "0, %.2f%% at 0.5, %.2f%% at 1/mm\n",
        name.c_str(), 100 * worst_near, 100 * worst_far, worst_pull, 100 * errors[0],
        100 * errors[50], 100 * errors[100]);
  }
  EXPECT_LE(beyond_half_percent, 4);
}

// Golden: R_d and the exit radiance at normal exit and at 45 degrees from adding and doubling
// (adding_doubling.py, which makes these lines), a deterministic method, to some 3e-6.
TEST(MonteCarlo, ReflectanceAndExitRadianceAreThoseOfRadiativeTransfer) {
  struct Case {
    double eta, anisotropy, absorption, reflectance, h_normal, h_45_deg;
  };
  const std::vector<Case> cases = {
      {1.4, 0.8, 1e-06, 0.9948963, 1.05974, 1.04367},
      {1.4, 0.8, 0.0001, 0.9506200, 1.05809, 1.04372},
      {1.4, 0.8, 0.001, 0.8541916, 1.05419, 1.04384},
      {1.4, 0.8, 0.01, 0.6211377, 1.04237, 1.04416},
      {1.4, 0.8, 0.1, 0.2601790, 1.00914, 1.04476},
      {1.4, 0.8, 1, 0.0356924, 0.93147, 1.04326},
      {1.4, 0.8, 10, 0.0024324, 0.88084, 1.03818},
      {1.4, 0.9, 1e-06, 0.9948717, 1.06041, 1.04368},
      {1.4, 0.9, 0.0001, 0.9506402, 1.05882, 1.04373},
      {1.4, 0.9, 0.001, 0.8542537, 1.05503, 1.04386},
      {1.4, 0.9, 0.01, 0.6212189, 1.04350, 1.04421},
      {1.4, 0.9, 0.1, 0.2595829, 1.01050, 1.04497},
      {1.4, 0.9, 1, 0.0343731, 0.92873, 1.04368},
      {1.4, 0.9, 10, 0.0022038, 0.87776, 1.03794},
      {1.4, 0, 1e-06, 0.9948940, 1.05594, 1.04362},
      {1.4, 0, 0.0001, 0.9504673, 1.05396, 1.04365},
      {1.4, 0, 0.001, 0.8538991, 1.04945, 1.04373},
      {1.4, 0, 0.01, 0.6222121, 1.03716, 1.04385},
      {1.4, 0, 0.1, 0.2726389, 1.01239, 1.04370},
      {1.4, 0, 1, 0.0537959, 0.98846, 1.04301},
      {1.4, 0, 10, 0.0062078, 0.98117, 1.04267},
      {1.3, 0.8, 1e-06, 0.9955965, 1.05850, 1.04013},
      {1.3, 0.8, 0.0001, 0.9571471, 1.05655, 1.04018},
      {1.3, 0.8, 0.001, 0.8718761, 1.05192, 1.04029},
      {1.3, 0.8, 0.01, 0.6564942, 1.03789, 1.04057},
      {1.3, 0.8, 0.1, 0.2927856, 0.99828, 1.04090},
      {1.3, 0.8, 1, 0.0426444, 0.90544, 1.03733},
      {1.3, 0.8, 10, 0.0029745, 0.84397, 1.02857},
      {1.5, 0.8, 1e-06, 0.9941138, 1.06103, 1.04574},
      {1.5, 0.8, 0.0001, 0.9434195, 1.05961, 1.04579},
      {1.5, 0.8, 0.001, 0.8352450, 1.05626, 1.04590},
      {1.5, 0.8, 0.01, 0.5859227, 1.04613, 1.04623},
      {1.5, 0.8, 0.1, 0.2315620, 1.01771, 1.04692},
      {1.5, 0.8, 1, 0.0302720, 0.95140, 1.04651},
      {1.5, 0.8, 10, 0.0020293, 0.90870, 1.04346},
  };
  double worst_pull = 0, worst = 0, worst_h = 0, worst_loss = 0;
  for (const Case& c : cases) {
    SCOPED_TRACE(::testing::Message()
                 << "eta " << c.eta << " g " << c.anisotropy << " x " << c.absorption);
    const auto made = make_monte_carlo({c.eta, c.anisotropy});
    ASSERT_TRUE(made);
    const auto& model = dynamic_cast<const MonteCarlo&>(**made);
    const double s = std::sqrt(3 * c.absorption * (1 + c.absorption));
    const double deviation = model.reflectance_at(s) / c.reflectance - 1;
    // The table's noise, its interpolation, and the golden numbers' own.
    const double error = std::hypot(model.relative_standard_error(s, 0), 5e-6);
    EXPECT_LT(std::abs(deviation), 3.5 * error);
    EXPECT_NEAR(model.exit_radiance(s, 1), c.h_normal, 0.012);
    EXPECT_NEAR(model.exit_radiance(s, std::sqrt(0.5)), c.h_45_deg, 0.005);
    // What is lost, which gives sigma_a near R_d = 1.
    worst_loss = std::max(worst_loss, std::abs(deviation) * c.reflectance / (1 - c.reflectance));
    worst_pull = std::max(worst_pull, std::abs(deviation) / error);
    if (c.reflectance > 0.1) worst = std::max(worst, std::abs(deviation));
    worst_h = std::max(worst_h, std::abs(model.exit_radiance(s, 1) - c.h_normal));
  }
  std::printf(
      "R_d within %.1f standard errors, %.3f%% where > 0.1; 1 - R_d within %.2f%%; h(normal) "
      "within %.4f\n",
      worst_pull, 100 * worst, 100 * worst_loss, worst_h);
}

}  // namespace
}  // namespace estimation
