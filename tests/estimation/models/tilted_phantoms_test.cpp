// The angular model on tests/data/mc_tilted.csv: flat phantoms tilted by 0 to 60 degrees and seen
// by a camera at 14, walked with 4e6 photons each by directional_monte_carlo.h.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdio>
#include <fstream>
#include <memory>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "estimation/models/scattering_model.h"

namespace estimation {
namespace {

using std::numbers::pi;
using Complex = std::complex<double>;

struct Phantom {
  std::string name;
  Coefficients medium;
  Directions directions;
  std::vector<double> f_per_mm, se;
  std::vector<Complex> value;  // T R~ h with its phase
};

std::vector<Phantom> phantoms() {
  std::ifstream file(SSRIG_TEST_DATA "/mc_tilted.csv");
  std::vector<Phantom> all;
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#' || line.starts_with("medium")) continue;
    std::stringstream cells(line);
    std::string name, cell;
    std::getline(cells, name, ',');
    std::vector<double> v;
    while (std::getline(cells, cell, ',')) v.push_back(std::stod(cell));
    if (v[6] == 0) {
      all.emplace_back();
      all.back().name = name;
      all.back().medium = {v[0], v[1]};
      all.back().directions = {v[2], v[4], v[3], v[5]};
    }
    all.back().f_per_mm.push_back(v[7]);
    all.back().value.emplace_back(v[8], v[9]);
    all.back().se.push_back(v[10]);
  }
  return all;
}

const ScatteringModel& model() {
  static const std::unique_ptr<ScatteringModel> kModel =
      *make_scattering_model("monte_carlo_angular", {});
  return *kModel;
}

// The harmonics of a material seen like `phantom`.
std::vector<Complex> predicted(const Phantom& phantom, double reflectance, double l_d_mm) {
  std::vector<double> k_times_l_d, transform(phantom.f_per_mm.size());
  for (const double f_per_mm : phantom.f_per_mm) k_times_l_d.push_back(2 * pi * f_per_mm * l_d_mm);
  std::vector<Complex> values(transform.size());
  model().transform(reflectance, k_times_l_d, transform);
  model().direction_factors(reflectance, k_times_l_d, phantom.directions, values);
  for (std::size_t n = 0; n < values.size(); ++n) values[n] *= transform[n];
  return values;
}

// R_d and l_d of a medium by the model: what coefficients() turns around.
std::pair<double, double> appearance(const Coefficients& medium) {
  double low = -20, high = 20;  // of the logit of R_d
  const double absorption = medium.sigma_a_per_mm / medium.sigma_s_prime_per_mm;
  for (int step = 0; step < 100; ++step) {
    const double middle = 0.5 * (low + high);
    const Coefficients found = model().coefficients(1 / (1 + std::exp(-middle)), 1);
    (found.sigma_a_per_mm / found.sigma_s_prime_per_mm > absorption ? low : high) = middle;
  }
  return {1 / (1 + std::exp(-low)),
          1 / std::sqrt(3 * medium.sigma_a_per_mm *
                        (medium.sigma_a_per_mm + medium.sigma_s_prime_per_mm))};
}

TEST(TiltedPhantoms, HarmonicsAreTheModels) {
  const std::vector<Phantom> all = phantoms();
  ASSERT_EQ(all.size(), 15U);
  double squares = 0, count = 0, worst = 0;
  for (const Phantom& phantom : all) {
    const auto [reflectance, l_d_mm] = appearance(phantom.medium);
    const std::vector<Complex> found = predicted(phantom, reflectance, l_d_mm);
    for (std::size_t n = 0; n < found.size(); ++n) {
      SCOPED_TRACE(phantom.name + " n " + std::to_string(n));
      const double error = std::abs(found[n] - phantom.value[n]) / std::abs(phantom.value[n]);
      EXPECT_LT(error, 0.008 + 4 * phantom.se[n] / std::abs(phantom.value[n]));
      worst = std::max(worst, error);
      if (2 * pi * phantom.f_per_mm[n] > 1.2 * phantom.medium.sigma_s_prime_per_mm) continue;
      squares += error * error;
      ++count;
    }
  }
  const double rms = std::sqrt(squares / count);
  std::printf("rms difference %.2f%% for k up to 1.2 sigma_s', at most %.1f%%\n", 100 * rms,
              100 * worst);
  EXPECT_LT(rms, 0.0035);
}

struct Found {
  Coefficients medium;
  double shift_mm;
};

// Least squares over (logit R_d, ln l_d, shift) of the stripe's harmonics, by Gauss-Newton.
Found fit(const Phantom& phantom) {
  std::array<double, 3> at{0, 0, 0};
  const auto residuals = [&](const std::array<double, 3>& p) {
    std::vector<double> all;
    const auto values = predicted(phantom, 1 / (1 + std::exp(-p[0])), std::exp(p[1]));
    for (std::size_t n = 0; n < values.size(); ++n) {
      const double x = pi * static_cast<double>(n) / 5;
      const double weight = n == 0 ? 1 : std::numbers::sqrt2 * std::sin(x) / x;
      const Complex turned = values[n] * std::polar(1.0, 2 * pi * phantom.f_per_mm[n] * p[2]);
      all.push_back(weight * (turned - phantom.value[n]).real());
      all.push_back(weight * (turned - phantom.value[n]).imag());
    }
    return all;
  };
  for (int step = 0; step < 30; ++step) {
    const std::vector<double> here = residuals(at);
    std::array<std::vector<double>, 3> slope;
    for (std::size_t i = 0; i < 3; ++i) {
      auto moved = at;
      moved[i] += 1e-4;
      slope[i] = residuals(moved);
      for (std::size_t j = 0; j < here.size(); ++j) slope[i][j] = (slope[i][j] - here[j]) / 1e-4;
    }
    double m[3][4] = {};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < here.size(); ++j) {
        for (std::size_t k = 0; k < 3; ++k) m[i][k] += slope[i][j] * slope[k][j];
        m[i][3] -= slope[i][j] * here[j];
      }
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t k = 0; k < 3; ++k) {
        if (k == i) continue;
        const double factor = m[k][i] / m[i][i];
        for (std::size_t j = 0; j < 4; ++j) m[k][j] -= factor * m[i][j];
      }
    for (std::size_t i = 0; i < 3; ++i) at[i] += std::clamp(m[i][3] / m[i][i], -0.5, 0.5);
  }
  return {model().coefficients(1 / (1 + std::exp(-at[0])), std::exp(at[1])), at[2]};
}

// The issue asks for 3% where the dipole is 1 to 40% off.
TEST(TiltedPhantoms, MaterialIsFoundFromTheirHarmonics) {
  double worst = 0, worst_shift_mm = 0;
  for (const Phantom& phantom : phantoms()) {
    SCOPED_TRACE(phantom.name);
    const Found found = fit(phantom);
    const double sigma_a = found.medium.sigma_a_per_mm / phantom.medium.sigma_a_per_mm - 1;
    const double sigma_s =
        found.medium.sigma_s_prime_per_mm / phantom.medium.sigma_s_prime_per_mm - 1;
    EXPECT_NEAR(sigma_a, 0, 0.012);
    EXPECT_NEAR(sigma_s, 0, 0.012);
    EXPECT_NEAR(found.shift_mm, 0, 0.005);
    worst = std::max({worst, std::abs(sigma_a), std::abs(sigma_s)});
    worst_shift_mm = std::max(worst_shift_mm, std::abs(found.shift_mm));
  }
  std::printf("coefficients within %.1f%%, shift within %.4f mm\n", 100 * worst, worst_shift_mm);
}

}  // namespace
}  // namespace estimation
