// The model monte_carlo against an independent Monte Carlo code, exact limits and its own inverse.
#include "estimation/models/monte_carlo.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "estimation/models/dipole.h"
#include "estimation/models/monte_carlo/photon_walk.h"
#include "estimation/models/monte_carlo/shipped_tables.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {
namespace {

MonteCarlo shipped(std::string_view file_name) {
  for (const ShippedTable& table : shipped_tables())
    if (table.file_name == file_name)
      return MonteCarlo(scattering_table_from_text(table.text, std::string(file_name)).value());
  ADD_FAILURE() << "no table " << file_name;
  return MonteCarlo({});
}

double transform(const ScatteringModel& model, double reflectance, double k_times_l_d) {
  double value = 0;
  model.transform(reflectance, std::span(&k_times_l_d, 1), std::span(&value, 1));
  return value;
}

double s_of(const Coefficients& medium) {
  const double x = medium.sigma_a_per_mm / medium.sigma_s_prime_per_mm;
  return std::sqrt(3 * x * (1 + x));
}

const std::vector<double>& reflectances() {
  static const std::vector<double> kValues = {
      1e-6, 1e-5, 1e-4,  1e-3,     0.01,     0.1,      0.3,      0.5,      0.7,
      0.9,  0.99, 0.999, 1 - 1e-4, 1 - 1e-5, 1 - 1e-6, 1 - 1e-7, 1 - 1e-8, 1 - 1e-9};
  return kValues;
}

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
// we 0.068446 +- 0.000024.
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

// A table without noise, of a function of the same kind: the dipole.
TEST(MonteCarlo, InterpolatesToOneInTenThousand) {
  const Dipole dipole(1.4);
  const auto exact = [&](double s, double k_tmfp) {
    const double extinction = 1 + absorption_at(s);
    const double s_dipole = s / extinction;  // of Dipole: sqrt(3 (1 - alpha'))
    double value = 0, k_times_l_d = k_tmfp / s;
    dipole.transform(dipole.reflectance_at(s_dipole), std::span(&k_times_l_d, 1),
                     std::span(&value, 1));
    return value;
  };
  ScatteringTable table;
  table.slope = (1 + 2.0 / 3 * boundary_factor(1.4));
  table.grid.node_count = 60;
  const double nearly_0 = 1e-9;
  for (int i = 0; i < table.grid.node_count; ++i) {
    table.exit_radiance.push_back({1, 0, 0, 0});
    table.exit_radiance_se.push_back(0);
    for (int j = 0; j < table.grid.node_count; ++j) {
      table.log_transform.push_back(
          std::log(exact(std::max(table.grid.node(i), nearly_0), table.grid.node(j))));
      table.log_transform_se.push_back(0);
    }
  }
  const MonteCarlo model(table);
  double worst = 0, worst_at_0 = 0;
  for (double s_place = 0.5; s_place < 34; s_place += 0.25) {
    for (double k_place = 0; k_place < 34; k_place += 0.25) {
      const double s = table.grid.scale * std::sinh(table.grid.step * s_place);
      const double k = table.grid.scale * std::sinh(table.grid.step * k_place);
      const double truth = exact(s, k);
      if (truth < 0.01) continue;
      const double error = std::abs(model.transform_at(s, k) / truth - 1);
      worst = std::max(worst, error);
      if (k_place == 0) worst_at_0 = std::max(worst_at_0, error);
    }
  }
  std::printf("interpolation error at most %.1e where R~ > 0.01, %.1e at k = 0\n", worst,
              worst_at_0);
  EXPECT_LT(worst, 1e-4);
}

// The error of a cubic spline goes with the fourth power of the step, so a table of every second
// node errs 16 times as much, and the nodes between show by how much.
TEST(MonteCarlo, ShippedTablesAreFineEnough) {
  for (const ShippedTable& file : shipped_tables()) {
    const auto full = scattering_table_from_text(file.text, std::string(file.file_name)).value();
    ScatteringTable half = full;
    half.grid.step *= 2;
    half.grid.node_count = (full.grid.node_count + 1) / 2;
    half.log_transform.clear();
    half.log_transform_se.clear();
    half.exit_radiance.resize(static_cast<std::size_t>(half.grid.node_count));
    for (int i = 0; i < full.grid.node_count; i += 2) {
      for (int j = 0; j < full.grid.node_count; j += 2) {
        half.log_transform.push_back(full.log_transform[full.at(i, j)]);
        half.log_transform_se.push_back(0);
      }
    }
    const MonteCarlo coarse(half);
    double worst = 0;
    for (int i = 1; i < full.grid.node_count; ++i) {
      for (int j = 0; j < full.grid.node_count; ++j) {
        const double truth = full.log_transform[full.at(i, j)];
        if (truth < std::log(0.01)) continue;
        worst = std::max(
            worst,
            std::abs(std::log(coarse.transform_at(full.grid.node(i), full.grid.node(j))) - truth));
      }
    }
    std::printf("%s: every second node errs by %.1e, all by about %.1e where R~ > 0.01\n",
                std::string(file.file_name).c_str(), worst, worst / 16);
    EXPECT_LT(worst / 16, 1e-4);
  }
}

TEST(MonteCarlo, ReflectanceAndSAreInverse) {
  for (const ShippedTable& file : shipped_tables()) {
    SCOPED_TRACE(std::string(file.file_name));
    const MonteCarlo model = shipped(file.file_name);
    double before = std::numeric_limits<double>::infinity();
    for (const double reflectance : reflectances()) {
      const double s = model.s_at(reflectance);
      EXPECT_LT(s, before) << reflectance;
      before = s;
      EXPECT_NEAR(model.reflectance_at(s), reflectance, 1e-13 * reflectance);
    }
    double falling = 1;
    for (double s = 1e-12; s < 1e8; s *= 1.1) {
      const double reflectance = model.reflectance_at(s);
      EXPECT_LE(reflectance, falling) << s;
      falling = reflectance;
      if (reflectance > 1 - 1e-8) continue;  // fewer digits of R_d than of s
      EXPECT_NEAR(model.s_at(reflectance), s, 1e-7 * s);
    }
    EXPECT_EQ(model.s_at(1), 0);
    EXPECT_TRUE(std::isinf(model.s_at(0)));
    for (const double outside : {-0.1, 1.0001, std::nan("")})
      EXPECT_TRUE(std::isnan(model.s_at(outside)));
  }
}

TEST(MonteCarlo, LimitsAreThoseOfDiffusionAndOfSingleScattering) {
  const MonteCarlo model = shipped("eta1.4_g0.8.txt");
  for (const double reflectance : reflectances()) {
    SCOPED_TRACE(reflectance);
    EXPECT_NEAR(transform(model, reflectance, 0), reflectance, 1e-12 * reflectance);
    double before = reflectance * (1 + 1e-12);
    for (double k_times_l_d = 1e-3; k_times_l_d < 1e12; k_times_l_d *= 1.3) {
      const double value = transform(model, reflectance, k_times_l_d);
      EXPECT_GT(value, 0);
      // The file holds ln R~ to 1e-6.
      EXPECT_LT(value, before * (1 + 1e-6)) << k_times_l_d;
      before = value;
    }
  }
  // 1 - R~ grows like sqrt(1 + (k l_d)^2) near R_d = 1.
  EXPECT_NEAR((1 - transform(model, 1 - 1e-6, 3)) / 1e-6, std::sqrt(10.0), 1e-4);
  EXPECT_EQ(transform(model, 1, 5), 1);
  EXPECT_EQ(transform(model, 0, 5), 0);
  EXPECT_EQ(transform(model, 0.5, std::numeric_limits<double>::infinity()), 0);
  for (const double outside : {-0.1, 1.1, std::nan("")})
    EXPECT_TRUE(std::isnan(transform(model, outside, 1)));
  EXPECT_TRUE(std::isnan(transform(model, 0.5, -1)));
  EXPECT_TRUE(std::isnan(transform(model, 0.5, std::nan(""))));
}

TEST(MonteCarlo, CoefficientsAreThoseOfTheTranslucency) {
  const MonteCarlo model = shipped("eta1.4_g0.8.txt");
  const Coefficients cheek_red{0.0525, 1.2814}, marble{0.0021, 2.19}, ink{3, 0.2};
  for (const Coefficients& medium : {cheek_red, marble, ink}) {
    const Coefficients back =
        model.coefficients(model.reflectance_at(s_of(medium)), diffuse_mean_free_path_mm(medium));
    EXPECT_NEAR(back.sigma_a_per_mm, medium.sigma_a_per_mm, 1e-10 * medium.sigma_a_per_mm);
    EXPECT_NEAR(back.sigma_s_prime_per_mm, medium.sigma_s_prime_per_mm,
                1e-10 * medium.sigma_s_prime_per_mm);
  }
  for (const double reflectance : reflectances()) {
    const Coefficients medium = model.coefficients(reflectance, 2.5);
    EXPECT_GT(medium.sigma_a_per_mm, 0);
    EXPECT_GT(medium.sigma_s_prime_per_mm, 0);
    EXPECT_NEAR(diffuse_mean_free_path_mm(medium), 2.5, 1e-9);
  }
}

TEST(MonteCarlo, SecondDerivativesHaveNoKinks) {
  const MonteCarlo model = shipped("eta1.4_g0.8.txt");
  // Second differences of ln R~ along ln k and along ln s, over a step much shorter than a cell. A
  // kink or a step at a node would show as a jump from one to the next.
  const double step = 0.01;
  for (const bool along_k : {true, false}) {
    for (const double other : {0.02, 0.1, 0.3, 1.0}) {
      double before = std::nan("");
      for (double place = std::log(0.003); place < std::log(8); place += step) {
        const auto log_transform = [&](double at) {
          return std::log(along_k ? model.transform_at(other, std::exp(at))
                                  : model.transform_at(std::exp(at), other));
        };
        const double second =
            (log_transform(place + step) - 2 * log_transform(place) + log_transform(place - step)) /
            (step * step);
        if (place > std::log(0.0031)) {
          EXPECT_NEAR(second, before, 0.05)
              << (along_k ? "k " : "s ") << std::exp(place) << " other " << other;
        }
        EXPECT_LT(std::abs(second), 1.5);
        before = second;
      }
    }
  }
}

TEST(MonteCarlo, DirectionsScaleByFresnelAndExitRadiance) {
  const MonteCarlo model = shipped("eta1.4_g0.8.txt");
  const auto factor = [&](double reflectance, double cos_incidence, double cos_exit) {
    const std::vector<double> k = {0, 1, 4};
    std::vector<std::complex<double>> out(3);
    model.direction_factors(reflectance, k, {.cos_incidence = cos_incidence, .cos_exit = cos_exit},
                            out);
    EXPECT_EQ(out[0], out[2]);
    EXPECT_EQ(out[1].imag(), 0);
    return out[0].real();
  };
  for (const double reflectance : {0.2, 0.3, 0.4, 0.5}) {
    SCOPED_TRACE(reflectance);
    // design/science.md: 0.99 to 1.03 at normal exit, 1.04 to 1.05 at 45 degrees, of R_d 0.2 to
    // 0.6.
    const double h = factor(reflectance, 1, 1) / transmitted_frac(1.4, 1);
    EXPECT_NEAR(h, 1.01, 0.03);
    EXPECT_NEAR(factor(reflectance, 1, std::sqrt(0.5)) / transmitted_frac(1.4, 1), 1.045, 0.006);
    EXPECT_NEAR(factor(reflectance, 0.5, 1) / h, transmitted_frac(1.4, 0.5), 1e-12);
    double mean = 0;
    for (int i = 0; i < 1000; ++i)
      mean += model.exit_radiance(model.s_at(reflectance), std::sqrt((i + 0.5) / 1000)) / 1000;
    EXPECT_NEAR(mean, 1, 1e-4);
  }
  EXPECT_EQ(factor(0.5, 0, 1), 0);
  EXPECT_EQ(factor(0.5, 1, -0.2), 0);
}

TEST(MonteCarlo, AnisotropyMattersAsPublished) {
  // design/science.md: g 0.9 against 0.8 at equal sigma_s' changes R(f) by 3 to 5% at 0.2/mm, by
  // about 0.5% at 0.05/mm.
  const MonteCarlo g8 = shipped("eta1.4_g0.8.txt"), g9 = shipped("eta1.4_g0.9.txt");
  const Coefficients cheek_red{0.0525, 1.2814};
  const auto change = [&](double f_per_mm) {
    const double k_tmfp = 2 * std::numbers::pi * f_per_mm / cheek_red.sigma_s_prime_per_mm;
    return std::abs(
        g9.transform_at(s_of(cheek_red), k_tmfp) / g8.transform_at(s_of(cheek_red), k_tmfp) - 1);
  };
  EXPECT_LT(change(0.05), 0.01);
  EXPECT_GT(change(0.2), 0.02);
  EXPECT_LT(change(0.2), 0.06);
}

TEST(MonteCarlo, OnlyListedMediaExist) {
  for (const MediumOptions& medium :
       std::vector<MediumOptions>{{}, {1.4, 0.9}, {1.4, 0}, {1.3, 0.8}, {1.5, 0.8}}) {
    const auto model = make_scattering_model("monte_carlo", medium);
    ASSERT_TRUE(model) << model.error().text();
    EXPECT_EQ((*model)->name(), "monte_carlo");
  }
  const auto missing = make_scattering_model("monte_carlo", {1.4, 0.85});
  ASSERT_FALSE(missing);
  EXPECT_EQ(
      missing.error().text(),
      "medium: is eta 1.4 with g 0.85; monte_carlo has tables for: eta 1.4 with g 0.8, eta 1.4 "
      "with g 0.9, eta 1.4 with g 0, eta 1.3 with g 0.8, eta 1.5 with g 0.8");
}

}  // namespace
}  // namespace estimation
